# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files made wrong by hand, by name: each is refused in one line that says what is wrong."""

import json
import re
import struct

import pytest

SECOND = 1_000_000_000
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
    "no topics": (file_of, "expected a field topic"),
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
