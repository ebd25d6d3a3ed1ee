# SPDX-License-Identifier: BSD-3-Clause
"""Logs that cannot be a survey, by name: each is refused in one line that says what is wrong and what to do."""

import json
import sqlite3
import struct

import numpy as np
import pytest
import yaml

from magmatch.data.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError, DataFormatError, SurveyError

SECOND = 1_000_000_000


def refusal(path, expected=DataFormatError, **settings):
    """The words of the one error."""
    with pytest.raises(expected) as caught:
        read_survey(path, SurveyFormat(**settings))
    words = str(caught.value)
    assert "\n" not in words
    assert len(words) < 900
    return words


# --- Cut off, in every container -----------------------------------------------------------------------------------

CONTAINERS = [
    "ROS 1 bag", "ROS 1 bag, bz2", "ROS 1 bag, lz4", "MCAP of ROS 2", "MCAP of ROS 1", "MCAP, lz4",
    "MCAP, not compressed", "MCAP without chunks", "MCAP without summary",
]  # fmt: skip
CUTS = {"after the signature": 0.0, "near the beginning": 0.03, "in the middle": 0.5, "near the end": 0.97}


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("name", CONTAINERS)
def test_a_log_cut_off_names_the_way_out(name, cut, made, flight, tmp_path):
    path = made.WRITERS[name](tmp_path, flight.series)
    raw = path.read_bytes()
    path.write_bytes(raw[: max(13 if path.suffix == ".bag" else 8, int(CUTS[cut] * len(raw)))])
    assert "--recover" in refusal(path)
    if cut in {"after the signature", "near the beginning"}:
        refusal(path, (DataFormatError, SurveyError), recover=True)  # too little is left


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("name", ["ROS 1 bag, bz2", "MCAP of ROS 2", "MCAP, lz4", "MCAP, not compressed"])
def test_a_hole_in_a_chunk_names_the_way_out(name, place, made, flight, tmp_path):
    path = made.WRITERS[name](tmp_path, flight.series)
    raw = bytearray(path.read_bytes())
    at = int(place * len(raw))
    raw[at : at + 300] = bytes(300)
    path.write_bytes(raw)
    assert "--recover" in refusal(path)


# --- Whole logs that hold no survey --------------------------------------------------------------------------------


def changed(series, k, **fields):
    from dataclasses import replace

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
    "neither": (lambda s: changed(s[:1], 0, type="std_msgs/msg/String"), {}, "expected a field topic"),
    "NaN in the field": (lambda s: with_value(s, 0, 7, np.nan), {}, "/imu/mag, message 7: holds NaN"),
    "infinity in a pose": (lambda s: with_value(s, 1, (4, 2), np.inf), {}, "/odom, message 4: holds NaN or infinity"),
    "zero quaternion": (lambda s: with_value(s, 1, (9, slice(3, 7)), 0), {}, "/odom, message 9: expected a unit"),
    "long quaternion": (lambda s: with_value(s, 1, (9, slice(3, 7)), 1), {}, "one of length 2"),
    "all poses zero": (lambda s: changed(s, 1, values=np.zeros((130, 7))), {}, "130 such messages"),
    "a number beyond reason": (lambda s: with_value(s, 1, (3, 0), 1e300), {}, "message 3: holds a number of 1e+300"),
    "field clock set back": (lambda s: set_back(s, 0), {}, "/imu/mag, message 60: time runs backward"),
    "pose clock set back": (lambda s: set_back(s, 1), {}, "/odom, message 60: time runs backward"),
    "no shared time": (
        lambda s: changed(s, 1, stamp_ns=s[1].stamp_ns + 900 * SECOND),
        {},
        "no sample lies within the trajectory",
    ),
    "one pose": (
        lambda s: changed(s, 1, log_ns=s[1].log_ns[:1], stamp_ns=None, values=s[1].values[:1]),
        {},
        "at least two poses, found 1",
    ),
    "unknown field topic": (lambda s: s, {"mag_topic": "/mag"}, "--mag-topic /mag: no such topic"),
    "unknown pose topic": (lambda s: s, {"pose_topic": "/pose"}, "--pose-topic /pose: no such topic"),
    "field topic of another type": (lambda s: s, {"mag_topic": "/odom"}, "expected a field topic"),
    "pose topic of another type": (lambda s: s, {"pose_topic": "/imu/mag"}, "expected a pose topic"),
    "frames without tf": (lambda s: s, {"pose_frames": "map,base"}, "tf does not connect 'base' to 'map'"),
    "positions only": (
        lambda s: changed(s, 1, type="geometry_msgs/msg/PointStamped", values=s[1].values[:, :3]),
        {},
        "cannot be turned",
    ),
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
@pytest.mark.parametrize("container", ["ROS 1 bag", "ROS 2 bag, sqlite3", "MCAP of ROS 2"])
def test_a_whole_log_without_a_survey_says_what_it_lacks(container, case, made, flight, tmp_path):
    change, settings, words = CONTENTS[case]
    path = made.WRITERS[container](tmp_path, change(flight.series))
    assert words in refusal(path, **settings)


IMPOSSIBLE = {
    "a field in microtesla": (lambda s: changed(s, 0, values=1e6 * s[0].values), "--field-unit uT"),
    "a dead sensor": (lambda s: changed(s, 0, values=0 * s[0].values), "every field value is zero"),
    "a robot that stood still": (
        lambda s: changed(s, 1, values=np.tile([1.0, 2, 3, 0, 0, 0, 1], (130, 1))),
        "one point",
    ),
    "five samples": (
        lambda s: changed(s, 0, log_ns=s[0].log_ns[:5], stamp_ns=None, values=s[0].values[:5]),
        "found 5",
    ),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_a_log_whose_survey_cannot_be_says_why(case, made, flight, tmp_path):
    change, words = IMPOSSIBLE[case]
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, change(flight.series))
    assert words in refusal(path, SurveyError)


EXTRINSICS = {
    "two numbers": ("1 2", "found 2 numbers"),
    "eight numbers": ("1 2 3 4 5 6 7 8", "found 8 numbers"),
    "NaN": ("0 0 nan 0 0 0 1", "NaN"),
    "zero quaternion": ("0 0 0 0 0 0 0", "length 0"),
    "long quaternion": ("0 0 0 1 1 1 1", "length 2"),
    "no such file": ("nowhere.yaml", "no such file"),
    "no YAML": ("!a: [", "expected the extrinsic"),
    "a list": ("[1, 2, 3]", "expected translation"),
    "no rotation": ("translation: [1, 2, 3]", "expected translation"),
    "half a translation": ("translation: [1, 2]\nrotation: [0, 0, 0, 1]", "expected translation"),
    "words": ("translation: [a, b, c]\nrotation: [0, 0, 0, 1]", "expected translation"),
    "no unit": ("translation: [1, 2, 3]\nrotation: [0, 0, 0, 5]", "length 5"),
    "values repeated without end": ("translation: &a [[*a, *a], *a]\nrotation: *a", "is not YAML"),
    "a Python object": ("translation: !!python/object/apply:os.abort []\nrotation: 1", "is not YAML"),
}


@pytest.mark.parametrize("case", EXTRINSICS)
def test_an_extrinsic_that_is_none_is_refused(case, made, flight, tmp_path):
    text, words = EXTRINSICS[case]
    if text.startswith(("!", "[", "translation")):
        (tmp_path / "extrinsic.yaml").write_text(text)
        text = str(tmp_path / "extrinsic.yaml")
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series)
    assert words in refusal(path, (DataFormatError, ConfigurationError), extrinsic=text)


# --- MCAP made by hand ---------------------------------------------------------------------------------------------

MAGIC = b"\x89MCAP0\r\n"
MAG, ODOM = "sensor_msgs/msg/MagneticField", "nav_msgs/msg/Odometry"


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
CDR = b"\0\1\0\0"
STAMP = struct.pack("<iI", 5, 0)
GOOD_FIELD = CDR + STAMP + text("m\0") + bytes(2) + struct.pack("<3d", 2e-5, 0, 0) + bytes(72)


def mcap_with(payload, encoding="cdr", name=MAG):
    """A field topic with one strange message, beside odometry that is never reached."""
    head = schema(1, name) + schema(2, ODOM) + channel(1, 1, "/mag", encoding) + channel(2, 2, "/odom", encoding)
    return file_of(head, message(1, payload), message(2, payload))


def bomb():
    """Chunks of one large message each, of zeros."""
    import zstandard

    content = message(1, bytes(150 << 20))
    return [chunk(zstandard.ZstdCompressor(level=1).compress(content), "zstd", len(content))] * 2


MCAPS = {
    "signature alone": (lambda: MAGIC, "--recover"),
    "two signatures": (lambda: MAGIC + MAGIC, "expected a field topic"),
    "no topics": (file_of, "expected a field topic"),
    "topics without messages": (lambda: file_of(TOPICS), "holds no messages"),
    "an unknown operation": (lambda: file_of(TOPICS, record(99, b"x")), "no record begins here"),
    "operation zero": (lambda: file_of(TOPICS, bytes(9)), "no record begins here"),
    "a record of exabytes": (lambda: MAGIC + struct.pack("<BQ", 5, 1 << 62) + MAGIC, "in the middle of a record"),
    "a schema of gigabytes": (
        lambda: MAGIC + struct.pack("<BQ", 3, 20 << 20) + bytes(20 << 20) + MAGIC,
        "more than the",
    ),
    "a chunk that declares terabytes": (lambda: file_of(TOPICS, chunk(b"x" * 50, "zstd", 1 << 40)), "more than the"),
    "a chunk of another length": (lambda: file_of(TOPICS, chunk(b"x" * 50, declared=49)), "do not fit each other"),
    "a chunk with more than it declares": (lambda: file_of(TOPICS, chunk(TOPICS, size=10)), "holds more"),
    "a chunk with less than it declares": (lambda: file_of(TOPICS, chunk(TOPICS, size=999)), "declares 999 bytes"),
    "a checksum that does not fit": (lambda: file_of(TOPICS, chunk(TOPICS, crc=1)), "checksum"),
    "an unknown compression": (lambda: file_of(TOPICS, chunk(b"x", "rar")), "compressed with 'rar'"),
    "zstd that is none": (lambda: file_of(TOPICS, chunk(b"x" * 50, "zstd", 100)), "zstd chunk is damaged"),
    "lz4 that is none": (lambda: file_of(TOPICS, chunk(b"x" * 50, "lz4", 100)), "lz4 chunk is damaged"),
    "a zip bomb": (lambda: file_of(TOPICS, *bomb()), "zip bomb"),
    "a chunk that breaks off": (lambda: file_of(TOPICS, chunk(message(1, GOOD_FIELD)[:-3])), "breaks off"),
    "a chunk of zeros": (lambda: file_of(TOPICS, chunk(bytes(900))), "record of operation 0"),
    "a message too short for its head": (lambda: file_of(TOPICS, chunk(record(5, b"xx"))), "breaks off"),
    "a channel without schema": (lambda: file_of(channel(1, 9, "/mag")), "schema 9, which is nowhere defined"),
    "a message without channel": (lambda: file_of(TOPICS, message(7, b"")), "channel 7, which is nowhere defined"),
    "a name of gigabytes": (lambda: file_of(record(3, b"\1\0" + struct.pack("<I", 1 << 31))), "string of 2147483648"),
    "a time beyond all calendars": (lambda: file_of(TOPICS, message(1, b"", (1 << 64) - 1)), "of the year 2554"),
    "an index that does not fit": (lambda: file_of(TOPICS, record(7, b"\1\0\x20\0\0\0abc")), "message index"),
    "protobuf": (lambda: mcap_with(b"x", "protobuf"), "encoded as 'protobuf', expected ros1, cdr, json"),
    "no payload": (lambda: mcap_with(b""), "/mag, message 0: a field of 4 bytes where 0 are left"),
    "half a header": (lambda: mcap_with(CDR + STAMP[:6]), "a field of 4 bytes where 2 are left"),
    "a frame of gigabytes": (lambda: mcap_with(CDR + STAMP + b"\xff\xff\xff\x7f"), "a field of 2147483647 bytes"),
    "half a field": (lambda: mcap_with(GOOD_FIELD[:-80]), "/mag, message 0: a field of"),
    "another definition": (lambda: mcap_with(GOOD_FIELD + bytes(8)), "8 bytes are left over"),
    "extended CDR": (lambda: mcap_with(b"\0\7" + GOOD_FIELD[2:]), "expected plain CDR"),
    "parameter lists": (lambda: mcap_with(b"\1\1" + GOOD_FIELD[2:]), "expected plain CDR"),
    "JSON that is none": (lambda: mcap_with(b"{", "json"), "is not the JSON of such a message"),
    "JSON of a list": (lambda: mcap_with(b"[]", "json"), "is not the JSON of such a message"),
    "JSON without a header": (lambda: mcap_with(b'{"magnetic_field": {}}', "json"), "KeyError: 'header'"),
    "JSON nested without end": (lambda: mcap_with(b"[" * 100_000, "json"), "is not the JSON"),
    "JSON of words": (
        lambda: mcap_with(
            json.dumps(
                {
                    "header": {"stamp": {"sec": 1, "nsec": 2}, "frame_id": ""},
                    "magnetic_field": dict.fromkeys("xyz", "a"),
                }
            ).encode(),
            "json",
        ),
        "could not convert",
    ),
}


@pytest.mark.parametrize("case", MCAPS)
def test_an_mcap_file_made_wrong_is_refused(case, tmp_path):
    make, words = MCAPS[case]
    pytest.importorskip("zstandard")
    (tmp_path / "log.mcap").write_bytes(make())
    assert words in refusal(tmp_path / "log.mcap")


# --- ROS 1 bags made by hand ---------------------------------------------------------------------------------------


def fields(**values):
    return b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in values.items())


def entry(head, data=b""):
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag(*entries, index_pos=1, **header):
    first = fields(op=b"\3", index_pos=struct.pack("<Q", index_pos), **header)
    return b"#ROSBAG V2.0\n" + entry(first) + b"".join(entries)


ZERO = bytes(4)
BAGS = {
    "version 1.2": (lambda: b"#ROSBAG V1.2\n" + bytes(99), "expected a bag of version 2.0, found '#ROSBAG V1.2'"),
    "encrypted": (lambda: bag(encryptor=b"aes"), "is an encrypted bag"),
    "never closed": (lambda: bag(index_pos=0), "never closed"),
    "index behind the end": (lambda: bag(index_pos=10**9), "without its end"),
    "another first record": (lambda: b"#ROSBAG V2.0\n" + entry(fields(op=b"\2")), "header is damaged"),
    "no records": (bag, "expected a field topic"),
    "a header of gigabytes": (lambda: bag(b"\xff\xff\xff\x7f"), "a header of 2147483647 bytes"),
    "a header that is none": (lambda: bag(entry(b"\7\0\0\0nothing")), "header is damaged"),
    "a header that breaks off": (lambda: bag(entry(b"\1\0")), "header breaks off"),
    "an unknown operation": (lambda: bag(entry(fields(op=b"\x33"))), "no record begins here"),
    "data of gigabytes": (lambda: bag(entry(fields(op=b"\2"))[:-4] + b"\xff\xff\xff\x7f"), "middle of a record"),
    "a chunk without its size": (lambda: bag(entry(fields(op=b"\5", compression=b"none"))), "without its size"),
    "a chunk that declares gigabytes": (
        lambda: bag(entry(fields(op=b"\5", compression=b"bz2", size=b"\0\0\0\x7f"), b"x")),
        "more than the",
    ),
    "an unknown compression": (
        lambda: bag(entry(fields(op=b"\5", compression=b"rar", size=ZERO), b"x")),
        "compressed with 'rar'",
    ),
    "bz2 that is none": (
        lambda: bag(entry(fields(op=b"\5", compression=b"bz2", size=b"\x09\0\0\0"), b"x" * 40)),
        "bz2 chunk is damaged",
    ),
    "a connection without type": (
        lambda: bag(entry(fields(op=b"\7", conn=ZERO, topic=b"/a"), fields(topic=b"/a"))),
        "without number or type",
    ),
    "a message without time": (
        lambda: bag(
            entry(fields(op=b"\5", compression=b"none", size=b"\x1a\0\0\0"), entry(fields(op=b"\2"), bytes(9)))
        ),
        "bytes but holds",
    ),
    "an index of another version": (
        lambda: bag(entry(fields(op=b"\4", ver=ZERO, conn=ZERO, count=ZERO))),
        "index whose lengths",
    ),
    "an index of another length": (
        lambda: bag(entry(fields(op=b"\4", ver=b"\1\0\0\0", conn=ZERO, count=b"\x09\0\0\0"))),
        "index whose lengths",
    ),
}


@pytest.mark.parametrize("case", BAGS)
def test_a_bag_made_wrong_is_refused(case, tmp_path):
    make, words = BAGS[case]
    (tmp_path / "log.bag").write_bytes(make())
    assert words in refusal(tmp_path / "log.bag")


# --- ROS 2 folders -------------------------------------------------------------------------------------------------


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


def remove(folder):
    (folder / "log-db3.db3").unlink()


FOLDERS = {
    "metadata that is no YAML": (lambda f: (f / "metadata.yaml").write_text("a: [b"), "is not YAML"),
    "metadata that is no text": (lambda f: (f / "metadata.yaml").write_bytes(b"\xff\xfe\xfd"), "is not YAML"),
    "metadata with code": (
        lambda f: (f / "metadata.yaml").write_text("!!python/object/apply:os.abort []"),
        "not YAML",
    ),
    "metadata repeated without end": (
        lambda f: (f / "metadata.yaml").write_text("rosbag2_bagfile_information: &a {x: [*a, *a]}"),
        "repeats values by name",
    ),
    "metadata of something else": (lambda f: (f / "metadata.yaml").write_text("a: b"), "rosbag2_bagfile_information"),
    "metadata of a list": (lambda f: (f / "metadata.yaml").write_text("- a"), "rosbag2_bagfile_information"),
    "empty metadata": (lambda f: (f / "metadata.yaml").write_text(""), "rosbag2_bagfile_information"),
    "a file elsewhere": (lambda f: about(f, relative_file_paths=["/etc/passwd"]), "outside the folder"),
    "a file above": (lambda f: about(f, relative_file_paths=["../x.db3"]), "outside the folder"),
    "files that are no names": (lambda f: about(f, relative_file_paths=[1]), "list of names"),
    "files that are no list": (lambda f: about(f, relative_file_paths="a"), "list of names"),
    "a missing file": (lambda f: about(f, relative_file_paths=["a.db3"]), "not in the folder; --recover"),
    "no file at all": (remove, "not in the folder"),
    "files compressed as a whole": (lambda f: (f / "x.db3.zstd").write_bytes(b"x"), "unzstd x.db3.zstd"),
    "messages compressed otherwise": (
        lambda f: about(f, compression_mode="message", compression_format="lz4"),
        "expected zstd",
    ),
    "messages said to be compressed": (
        lambda f: about(f, compression_mode="message", compression_format="zstd"),
        "message 0: ",
    ),
    "an empty file": (lambda f: (f / "log-db3.db3").write_bytes(b""), "is no ROS 1 bag, ROS 2 bag or MCAP"),
    "a file of text": (lambda f: (f / "log-db3.db3").write_text("hello"), "is no ROS 1 bag"),
    "a database without pages": (
        lambda f: (f / "log-db3.db3").write_bytes(b"SQLite format 3\0" + bytes(200)),
        "damaged ROS 2 bag",
    ),
    "a database of something else": (lambda f: run_sql(f, "DROP TABLE messages"), "without table messages"),
    "no topics": (lambda f: run_sql(f, "DELETE FROM topics"), "expected a field topic"),
    "no messages": (lambda f: run_sql(f, "DELETE FROM messages"), "holds no messages"),
    "columns of another time": (
        lambda f: run_sql(f, "ALTER TABLE messages RENAME COLUMN data TO blob"),
        "no such column: data",
    ),
    "data of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET data = 'text'"),
        "no number, time stamp or data",
    ),
    "stamps of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET timestamp = 'now'"),
        "time stamp is no whole number",
    ),
    "names of another kind": (lambda f: run_sql(f, "UPDATE topics SET name = x'ff'"), "other things than names"),
    "payloads of zeros": (lambda f: run_sql(f, "UPDATE messages SET data = zeroblob(50)"), "message 0: "),
    "payloads of nothing": (lambda f: run_sql(f, "UPDATE messages SET data = x''"), "where 0 are left"),
    "another serialisation": (
        lambda f: run_sql(f, "UPDATE topics SET serialization_format = 'xml'"),
        "encoded as 'xml'",
    ),
    "types exchanged": (
        lambda f: run_sql(f, f"UPDATE topics SET type = '{MAG}' WHERE name = '/odom'"),
        "/odom, message 0: ",
    ),
}


@pytest.mark.parametrize("case", FOLDERS)
def test_a_ros2_bag_made_wrong_is_refused(case, made, flight, tmp_path):
    damage, words = FOLDERS[case]
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    damage(folder)
    settings = {"mag_topic": "/odom", "pose_topic": "/odom"} if case == "types exchanged" else {}
    if settings:
        settings = {"mag_topic": "/odom", "trajectory": tmp_path / "poses.tum"}
        flight.trajectory().save(tmp_path / "poses.tum")
    assert words in refusal(folder, **settings)


def test_a_bag_without_metadata_is_read_by_its_files(made, flight, tmp_path):
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    (folder / "metadata.yaml").unlink()
    assert len(read_survey(folder)) == 300
    assert len(read_survey(folder / "log-db3.db3")) == 300


@pytest.mark.parametrize("name", ["log.csv", "log.db3", "log", "log.bag"])
def test_the_name_of_a_log_does_not_matter(name, made, flight, tmp_path):
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series).rename(tmp_path / name)
    assert len(read_survey(path)) == 300
