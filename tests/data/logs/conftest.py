# SPDX-License-Identifier: BSD-3-Clause
"""One recording in every container, written by the libraries of the formats themselves."""

import json
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND + 123_456_789
MAG, ODOM, POSE, COVARIANCE = (
    "sensor_msgs/msg/MagneticField",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
TRANSFORM, TF, POINT, VECTOR, STRING = (
    "geometry_msgs/msg/TransformStamped",
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/Vector3Stamped",
    "std_msgs/msg/String",
)
BATTERY, JOINTS, VALUE, ARRAY = (
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float32MultiArray",
)
VECTOR_FIELDS = {MAG: "magnetic_field", VECTOR: "vector", POINT: "point"}


@dataclass
class Series:
    """Messages of one topic: log times, header stamps (both ns), numbers, and what stands around them."""

    topic: str
    type: str
    log_ns: np.ndarray
    values: np.ndarray
    frame: str = "map"
    child: str = ""
    stamp_ns: np.ndarray = None
    is_latched: bool = False

    def __post_init__(self):
        if self.stamp_ns is None:
            self.stamp_ns = self.log_ns


@dataclass
class Flight:
    """A walk with a magnetometer: field at 50 Hz in the sensor's frame, poses at 20 Hz."""

    mag_ns: np.ndarray
    mag: np.ndarray
    pose_ns: np.ndarray
    poses: np.ndarray
    series: list = field(default_factory=list)

    def trajectory(self):
        from magmatch.data.tables.times import seconds_of
        from magmatch.data.trajectory import Trajectory

        times = seconds_of(self.pose_ns.tolist())
        return Trajectory(times, self.poses[:, :3], Rotation.from_quat(self.poses[:, 3:]))


def make_flight(n_mag=300, n_pose=130, seed=3):
    rng = np.random.default_rng(seed)
    mag_ns = START + np.arange(n_mag) * 20_000_001
    pose_ns = START - 111_111_111 + np.arange(n_pose) * 50_000_003
    t = (pose_ns - START) / SECOND
    positions = np.column_stack([np.cos(t), np.sin(1.3 * t), 0.2 * np.sin(0.7 * t)])
    turns = Rotation.from_rotvec(np.column_stack([0.3 * np.sin(t), 0.2 * np.cos(t), 0.8 * t]))
    field = 1e-6 * (np.array([18.0, 3.0, -45.0]) + rng.normal(0, 2, (n_mag, 3)))
    poses = np.hstack([positions, turns.as_quat()])
    series = [
        Series("/imu/mag", MAG, mag_ns, field, frame="mag_link"),
        Series("/odom", ODOM, pose_ns, poses, child="mag_link"),
    ]
    return Flight(mag_ns, field, pose_ns, poses, series)


@lru_cache
def type_store(version):
    """Types of ROS 1, to which one belongs that rosbags leaves out, or ROS 2."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    if version == 1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


class Messages:
    """Makes messages of a type store, for ROS 1 or ROS 2."""

    def __init__(self, version):
        self.is_ros1 = version == 1
        self.store, self.zeros = type_store(version), {}

    def filled(self, kind, content):
        """A message of a type; what the content does not name is zero, empty or false."""
        from rosbags.interfaces import Nodetype

        def value(given, what, detail):
            if what is Nodetype.NAME:
                if given is None and detail not in self.zeros:
                    self.zeros[detail] = self.filled(detail, {})
                return self.zeros[detail] if given is None else self.filled(detail, given)
            if what is Nodetype.BASE:
                return given if given is not None else {"string": "", "bool": False}.get(detail[0], 0)
            (inner, name), n = detail
            given = [0] * n if given is None else given
            if inner is Nodetype.NAME or name[0] == "string":
                return [value(one, inner, name) for one in given]
            return np.array(given, name[0])

        fields = {name: value(content.get(name), *node) for name, node in self.store.fielddefs[kind][1]}
        return self.store.types[kind](**fields)

    def build(self, series, i):
        return self.filled(series.type, content_of(series, i))

    def serialise(self, message, kind):
        return (self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr)(message, kind)


def content_of(series, i):
    """What a message says, by the names of its fields."""
    v, kind, stamp = series.values[i], series.type, int(series.stamp_ns[i])
    if kind == STRING:
        return {"data": str(v)}
    header = {"stamp": {"sec": stamp // SECOND, "nanosec": stamp % SECOND}, "frame_id": series.frame}
    if kind in {BATTERY, JOINTS, VALUE, ARRAY}:  # whose only number that matters is the current
        amps = float(v)
        content = {"data": [amps, 2 * amps] if kind == ARRAY else amps, "current": amps}
        return content | {"header": header, "name": ["left", "right_wheel"], "effort": [amps, -amps]}
    first, turn = dict(zip("xyz", map(float, v), strict=False)), dict(zip("xyzw", map(float, v[3:]), strict=False))
    pose = {"position": first, "orientation": turn}
    content = {"header": header, "child_frame_id": series.child}
    if kind in {MAG, VECTOR, POINT}:
        return content | {VECTOR_FIELDS[kind]: first}
    if kind in {TRANSFORM, TF}:
        content["transform"] = {"translation": first, "rotation": turn}
        return {"transforms": [content]} if kind == TF else content
    return content | {"pose": pose if kind == POSE else {"pose": pose, "covariance": [1.0] * 36}}


def in_time(series, messages):
    """All messages of some topics in order of logging: (topic index, log time, bytes); JSON without `messages`."""
    rows = [(int(t), k, i) for k, s in enumerate(series) for i, t in enumerate(s.log_ns)]
    for t, k, i in sorted(rows):
        if messages is None:
            yield k, t, json.dumps(content_of(series[k], i)).encode()
        else:
            yield k, t, bytes(messages.serialise(messages.build(series[k], i), series[k].type))


def write_ros1(path, series, compression=None):
    from rosbags.rosbag1 import Writer

    messages = Messages(1)
    writer = Writer(path)
    writer.chunk_threshold = 20_000
    if compression:
        writer.set_compression(getattr(Writer.CompressionFormat, compression.upper()))
    with writer:
        connections = [writer.add_connection(s.topic, s.type, typestore=messages.store) for s in series]
        for k, t, data in in_time(series, messages):
            writer.write(connections[k], t, data)
    return path


def write_ros2(path, series, storage="sqlite3", compression=None):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    messages = Messages(2)
    writer = Writer(path, version=9, storage_plugin=getattr(StoragePlugin, storage.upper()))
    if compression:
        writer.set_compression(getattr(CompressionMode, compression.upper()), CompressionFormat.ZSTD)
    with writer:
        connections = [writer.add_connection(s.topic, s.type, typestore=messages.store) for s in series]
        for k, t, data in in_time(series, messages):
            writer.write(connections[k], t, data)
    return path


def write_mcap(path, series, encoding="cdr", compression="ZSTD", chunk_size=20_000, **options):
    from mcap.writer import CompressionType, Writer

    messages = None if encoding == "json" else Messages(1 if encoding == "ros1" else 2)
    with Path(path).open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, compression=getattr(CompressionType, compression), **options)
        writer.start()
        channels = []
        for s in series:
            name = s.type.replace("/msg/", "/") if encoding == "ros1" else s.type
            kind = {"ros1": "ros1msg", "cdr": "ros2msg", "json": "jsonschema"}[encoding]
            schema = writer.register_schema(name, kind, b"{}" if encoding == "json" else b"# definition")
            channels.append(writer.register_channel(s.topic, encoding, schema))
        for n, (k, t, data) in enumerate(in_time(series, messages)):
            writer.add_message(channels[k], t, data, t, n)
        writer.finish()
    return path


def write_bare_mcap(path, series):
    from mcap.writer import IndexType

    bare = {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False, "use_summary_offsets": False}
    return write_mcap(path, series, **bare, index_types=IndexType.NONE)


WRITERS = {
    "ROS 1 bag": lambda folder, series: write_ros1(folder / "log.bag", series),
    "ROS 1 bag, bz2": lambda folder, series: write_ros1(folder / "log-bz2.bag", series, "bz2"),
    "ROS 1 bag, lz4": lambda folder, series: write_ros1(folder / "log-lz4.bag", series, "lz4"),
    "ROS 2 bag, sqlite3": lambda folder, series: write_ros2(folder / "log-db3", series),
    "ROS 2 bag, messages compressed": lambda folder, series: write_ros2(
        folder / "log-db3z", series, compression="message"
    ),
    "ROS 2 bag, mcap": lambda folder, series: write_ros2(folder / "log-mcap", series, "mcap"),
    "MCAP of ROS 2": lambda folder, series: write_mcap(folder / "log.mcap", series),
    "MCAP of ROS 1": lambda folder, series: write_mcap(folder / "log1.mcap", series, "ros1"),
    "MCAP of JSON": lambda folder, series: write_mcap(folder / "logj.mcap", series, "json"),
    "MCAP, lz4": lambda folder, series: write_mcap(folder / "logl.mcap", series, compression="LZ4"),
    "MCAP, not compressed": lambda folder, series: write_mcap(folder / "logn.mcap", series, compression="NONE"),
    "MCAP without chunks": lambda folder, series: write_mcap(folder / "logc.mcap", series, use_chunking=False),
    "MCAP without summary": lambda folder, series: write_bare_mcap(folder / "logs.mcap", series),
}  # fmt: skip


@pytest.fixture(scope="session")
def made():
    """Functions that make recordings and write them."""
    pytest.importorskip("rosbags", reason="logs are written by rosbags and mcap")
    return SimpleNamespace(
        flight=make_flight, Series=Series, Messages=Messages, WRITERS=WRITERS,
        ros1=write_ros1, ros2=write_ros2, mcap=write_mcap, replace=replace,
        numbers={"/battery": BATTERY, "/joints": JOINTS, "/motors": ARRAY, "/amps": VALUE},
    )  # fmt: skip


@pytest.fixture(params=WRITERS)
def container(request):
    """The name of each container in turn."""
    return request.param


@pytest.fixture
def flight():
    return make_flight()


@pytest.fixture
def saved(made, tmp_path):
    """Write topics as MCAP (quick and small)."""
    return lambda *series: made.mcap(tmp_path / "log.mcap", list(series))


def refuse(path, expected=DataFormatError, **settings):
    """The words of the one error with which a log is refused."""
    with pytest.raises(expected) as caught:
        read_survey(path, SurveyFormat(**settings))
    words = str(caught.value)
    assert "\n" not in words
    assert len(words) < 900
    return words


@pytest.fixture
def refusal():
    return refuse
