# SPDX-License-Identifier: BSD-3-Clause
"""Logs that cannot be a survey, by name: each is refused in one line that says what is wrong and what to do."""

import json
import re
import sqlite3
import struct
from dataclasses import replace

import numpy as np
import pytest
import yaml

from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError, DataFormatError

SECOND = 1_000_000_000
MAG, ODOM = "sensor_msgs/msg/MagneticField", "nav_msgs/msg/Odometry"


# --- Whole logs that hold no survey --------------------------------------------------------------------------------


def changed(series, k, **fields):
    return [replace(s, **fields) if i == k else s for i, s in enumerate(series)]


def with_value(series, k, row, value):
    values = series[k].values.copy()
    values[row] = value
    return changed(series, k, values=values)


def set_back(series, k):
    stamps = series[k].stamp_ns.copy()
    stamps[60:] -= 5 * SECOND
    return changed(series, k, stamp_ns=stamps)


CONTENTS = {
    "no field topic": (lambda s: s[1:], {}, "expected a field topic"),
    "no pose topic": (lambda s: s[:1], {}, "expected a pose topic"),
    "NaN in the field": (lambda s: with_value(s, 0, 7, np.nan), {}, "/imu/mag, message 7: holds NaN"),
    "zero quaternion": (lambda s: with_value(s, 1, (9, slice(3, 7)), 0), {}, "/odom, message 9: expected a unit"),
    "all poses zero": (lambda s: changed(s, 1, values=np.zeros((130, 7))), {}, "none of its 130 messages"),
    "a number beyond reason": (lambda s: with_value(s, 1, (3, 0), 1e300), {}, "message 3: holds a number of 1e+300"),
    "pose clock set back": (lambda s: set_back(s, 1), {}, "/odom, message 60: time runs backward"),
    "no shared time": (
        lambda s: changed(s, 1, log_ns=s[1].log_ns + 900 * SECOND, stamp_ns=s[1].stamp_ns + 900 * SECOND),
        {},
        "no sample lies within the trajectory",
    ),
    "one pose": (
        lambda s: changed(s, 1, log_ns=s[1].log_ns[:1], stamp_ns=None, values=s[1].values[:1]),
        {},
        "at least two poses, found 1",
    ),
    "unknown field topic": (lambda s: s, {"mag_topic": "/mag"}, "--mag-topic /mag: no such topic"),
    "pose topic of another type": (lambda s: s, {"pose_topic": "/imu/mag"}, "expected a pose topic"),
    "positions only": (
        lambda s: changed(s, 1, type="geometry_msgs/msg/PointStamped", values=s[1].values[:, :3]),
        {},
        "cannot be turned",
    ),
    "frames without tf": (lambda s: s, {"pose_frames": "map,base"}, "tf does not connect 'base' to 'map'"),
    "static tf only": (
        lambda s: changed(s, 1, topic="/tf_static", type="tf2_msgs/msg/TFMessage"),
        {},
        "expected a pose topic",
    ),
    "tf that lacks the sensor": (
        lambda s: changed(s, 1, topic="/tf", type="tf2_msgs/msg/TFMessage", child="wheel"),
        {},
        "tf does not know 'mag_link'",
    ),
}


@pytest.mark.parametrize("case", CONTENTS)
def test_a_whole_log_without_a_survey_says_what_it_lacks(case, made, flight, tmp_path, refusal):
    change, settings, words = CONTENTS[case]
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, change(flight.series))
    assert words in refusal(path, **settings)


EXTRINSICS = {
    "eight numbers": ("1 2 3 4 5 6 7 8", "found 8 numbers"),
    "NaN": ("0 0 nan 0 0 0 1", "NaN"),
    "zero quaternion": ("0 0 0 0 0 0 0", "length 0"),
    "long quaternion": ("0 0 0 1 1 1 1", "length 2"),
    "no such file": ("nowhere.yaml", "no such file"),
    "no YAML": ("!a: [", "expected the extrinsic"),
    "no rotation": ("translation: [1, 2, 3]", "expected translation"),
    "no unit": ("translation: [1, 2, 3]\nrotation: [0, 0, 0, 5]", "length 5"),
    "values repeated without end": ("translation: &a [[*a, *a], *a]\nrotation: *a", "is not YAML"),
    "a Python object": ("translation: !!python/object/apply:os.abort []\nrotation: 1", "is not YAML"),
}


@pytest.mark.parametrize("case", EXTRINSICS)
def test_an_extrinsic_that_is_none_is_refused(case, made, flight, tmp_path, refusal):
    text, words = EXTRINSICS[case]
    if text.startswith(("!", "[", "translation")):
        (tmp_path / "extrinsic.yaml").write_text(text)
        text = str(tmp_path / "extrinsic.yaml")
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series)
    assert words in refusal(path, (DataFormatError, ConfigurationError), extrinsic=text)


@pytest.mark.parametrize("name", ["log.csv", "log.db3"])
def test_the_name_of_a_log_does_not_matter(name, made, flight, tmp_path):
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series).rename(tmp_path / name)
    assert len(read_survey(path)) == 300


# --- MCAP files made wrong by hand ---------------------------------------------------------------------------------

MAGIC = b"\x89MCAP0\r\n"


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def schema(key, name):
    return record(3, struct.pack("<H", key) + text(name) + text("ros2msg") + text(""))


def channel(key, schema_id, topic, encoding="cdr"):
    return record(4, struct.pack("<HH", key, schema_id) + text(topic) + text(encoding) + struct.pack("<I", 0))


def message(key, payload, log_ns=SECOND):
    return record(5, struct.pack("<HIQQ", key, 0, log_ns, log_ns) + payload)


def chunk(content, compression="", size=None, crc=0, declared=None):
    head = struct.pack("<QQQI", 0, 1, len(content) if size is None else size, crc) + text(compression)
    body = head + struct.pack("<Q", len(content) if declared is None else declared) + content
    return record(6, body)


def file_of(*records):
    return MAGIC + b"".join(records) + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


TOPICS = schema(1, MAG) + schema(2, ODOM) + channel(1, 1, "/mag") + channel(2, 2, "/odom")
MENDED = "mcap recover mends it"


def mcap_with(payload, encoding="cdr", name=MAG):
    """A field topic with one strange message, beside odometry that is never reached."""
    head = schema(1, name) + schema(2, ODOM) + channel(1, 1, "/mag", encoding) + channel(2, 2, "/odom", encoding)
    return file_of(head, message(1, payload), message(2, payload))


def json_field(stamp=None, frame="", **axes):
    header = {"stamp": stamp or {"sec": 1, "nsec": 2}, "frame_id": frame}
    return json.dumps({"header": header, "magnetic_field": {"x": 1e-5, "y": 0, "z": 0} | axes}).encode()


MCAPS = {
    "signature alone": (lambda: MAGIC, MENDED),
    "topics without messages": (lambda: file_of(TOPICS), "holds no messages"),
    "a chunk that declares terabytes": (lambda: file_of(TOPICS, chunk(b"x" * 50, "zstd", 1 << 40)), MENDED),
    "a checksum that does not fit": (lambda: file_of(TOPICS, chunk(TOPICS, crc=1)), "crc validation failed in Chunk"),
    "a channel without schema": (lambda: file_of(channel(1, 9, "/mag")), "schema 9, which is nowhere defined"),
    "a message without channel": (lambda: file_of(TOPICS, message(7, b"")), "channel 7, which is nowhere defined"),
    "a time beyond all calendars": (lambda: file_of(TOPICS, message(1, b"", (1 << 64) - 1)), "of the year 2554"),
    "protobuf": (lambda: mcap_with(b"x", "protobuf"), "encoded as 'protobuf', expected ros1, cdr, json"),
    "no payload": (lambda: mcap_with(b""), "/mag, message 0: is cut off or damaged"),
    "JSON that is none": (lambda: mcap_with(b"{", "json"), "is not the JSON of such a message"),
    "JSON without a header": (lambda: mcap_with(b'{"magnetic_field": {}}', "json"), "no attribute 'header'"),
    "JSON without a number": (lambda: mcap_with(json_field(x=None), "json"), "holds NaN or infinity"),
    "JSON whose stamp is none": (lambda: mcap_with(json_field({"foo": 1}), "json"), "(KeyError: 'sec')"),
    "JSON of a time beyond all": (lambda: mcap_with(json_field({"sec": 1e20, "nsec": 1}), "json"), "OverflowError"),
}


@pytest.mark.parametrize("case", MCAPS)
def test_an_mcap_file_made_wrong_is_refused(case, tmp_path, refusal):
    make, words = MCAPS[case]
    pytest.importorskip("zstandard")
    (tmp_path / "log.mcap").write_bytes(make())
    assert words in refusal(tmp_path / "log.mcap")


def test_messages_that_a_damaged_length_hides_are_missed(made, flight, tmp_path, refusal):
    """Without a checksum nothing but the index tells."""
    path = made.mcap(tmp_path / "log.mcap", flight.series, compression="NONE", enable_crcs=False)
    raw = bytearray(path.read_bytes())
    found = re.search(rb"\x05([^\0]{2}\0{6})", raw)
    raw[found.start(1) : found.end(1)] = struct.pack("<Q", 5000)
    path.write_bytes(raw)
    assert "its chunks hold other messages than its index names" in refusal(path)


# --- ROS 2 bag folders made wrong ----------------------------------------------------------------------------------


def about(folder, **changes):
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"] |= changes
    path.write_text(yaml.safe_dump(content))


def run_sql(folder, *statements):
    database = sqlite3.connect(folder / "log-db3.db3")
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()


FOLDERS = {
    "metadata that is no YAML": (lambda f: (f / "metadata.yaml").write_text("a: [b"), "is not YAML"),
    "metadata repeated without end": (
        lambda f: (f / "metadata.yaml").write_text("rosbag2_bagfile_information: &a {x: [*a, *a]}"),
        "repeats values by name",
    ),
    "metadata of something else": (lambda f: (f / "metadata.yaml").write_text("a: b"), "rosbag2_bagfile_information"),
    "a file elsewhere": (lambda f: about(f, relative_file_paths=["/etc/a\0.db3"]), "outside the folder"),
    "files that are no names": (lambda f: about(f, relative_file_paths=[1]), "list of names"),
    "files compressed as a whole": (lambda f: (f / "x.db3.zstd").write_bytes(b"x"), "unzstd x.db3.zstd"),
    "messages compressed otherwise": (
        lambda f: about(f, compression_mode="message", compression_format="lz4"),
        "expected zstd",
    ),
    "messages said to be compressed": (
        lambda f: about(f, compression_mode="message", compression_format="zstd"),
        "says that messages are compressed, found one that is not",
    ),
    "messages of no topic": (lambda f: run_sql(f, "UPDATE messages SET topic_id = 99"), "holds no messages"),
    "a database of something else": (lambda f: run_sql(f, "DROP TABLE messages"), "without table messages"),
    "no topics": (lambda f: run_sql(f, "DELETE FROM topics"), "expected a field topic"),
    "data of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET data = 'text'"),
        "without a whole number as time stamp, or data",
    ),
    "stamps of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET timestamp = 'now'"),
        "time stamp is no whole number",
    ),
    "names of another kind": (lambda f: run_sql(f, "UPDATE topics SET name = x'ff'"), "other things than names"),
    "payloads of zeros": (lambda f: run_sql(f, "UPDATE messages SET data = zeroblob(50)"), "message 0: "),
    "another serialisation": (
        lambda f: run_sql(f, "UPDATE topics SET serialization_format = 'xml'"),
        "encoded as 'xml'",
    ),
}


@pytest.mark.parametrize("case", FOLDERS)
def test_a_ros2_bag_made_wrong_is_refused(case, made, flight, tmp_path, refusal):
    damage, words = FOLDERS[case]
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    damage(folder)
    assert words in refusal(folder)


def test_a_bag_without_metadata_is_read_by_its_files(made, flight, tmp_path):
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    (folder / "metadata.yaml").unlink()
    assert len(read_survey(folder)) == 300
    assert len(read_survey(folder / "log-db3.db3")) == 300
