# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 bags made wrong by hand, by name: refused in one line that says what is wrong, and recovered without it."""

import bz2
import struct

import numpy as np
import pytest

from magmatch.data.logs.open import open_log


def fields(**values):
    return b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in values.items())


def entry(head, data=b""):
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag(*entries, index_pos=1, **header):
    counts = {"conn_count": b"\1\0\0\0", "chunk_count": b"\1\0\0\0"} | header
    first = fields(op=b"\3", index_pos=struct.pack("<Q", index_pos), **counts)
    return b"#ROSBAG V2.0\n" + entry(first) + b"".join(entries)


def chunk_of(raw, compression=b"none", size=None):
    n = len(raw) if size is None else size
    return entry(fields(op=b"\5", compression=compression, size=struct.pack("<I", n)), raw)


def bomb():
    """Chunks of one large message each, of zeros; their connection is defined."""
    content = entry(fields(op=b"\2", conn=bytes(4), time=bytes(8)), bytes(3 << 20))
    connection = entry(
        fields(op=b"\7", conn=bytes(4), topic=b"/mag"), fields(topic=b"/mag", type=b"sensor_msgs/MagneticField")
    )
    return bag(connection, *[chunk_of(bz2.compress(content), b"bz2", size=len(content))] * 2)


ZERO = bytes(4)
REFUSED = {
    "version 1.2": (lambda: b"#ROSBAG V1.2\n" + bytes(99), "expected a bag of version 2.0, found '#ROSBAG V1.2'"),
    "encrypted": (lambda: bag(encryptor=b"aes"), "is an encrypted bag"),
    "never closed": (lambda: bag(index_pos=0), "Bag is not indexed"),
    "index behind the end": (lambda: bag(index_pos=10**9), "index looks damaged"),
    "index behind any end": (lambda: bag(index_pos=(1 << 63) - 1), "--recover"),
    "index beyond all numbers": (lambda: bag(index_pos=(1 << 64) - 1), "--recover"),
    "another first record": (lambda: b"#ROSBAG V2.0\n" + entry(fields(op=b"\2")), "'MSGDATA' is unexpected"),
    "a header of gigabytes": (lambda: b"#ROSBAG V2.0\n\xff\xff\xff\x7f", "a header of 2147483647 bytes"),
    "no records": (lambda: bag(chunk_count=ZERO), "expected a field topic"),
    "an index of something else": (lambda: bag(chunk_of(b"x" * 99), index_pos=99), "index looks damaged"),
}
LOST = {
    "a header of gigabytes": (lambda: bag(b"\xff\xff\xff\x7f"), "a header of 2147483647 bytes"),
    "a header that is none": (lambda: bag(entry(b"\7\0\0\0nothing")), "Header field could not be parsed"),
    "a header that breaks off": (lambda: bag(entry(b"\1\0")), "Header field size could not be read"),
    "a name of a field without end": (
        lambda: bag(entry(struct.pack("<I", 1 << 30) + b"op=")),
        "too large for header",
    ),
    "an unknown operation": (lambda: bag(entry(fields(op=b"\x33"))), "no record begins here"),
    "a record without operation": (lambda: bag(entry(fields(conn=ZERO))), "field 'op'"),
    "data of gigabytes": (lambda: bag(entry(fields(op=b"\2"))[:-4] + b"\xff\xff\xff\x7f"), "middle of a record"),
    "an unknown compression": (lambda: bag(chunk_of(b"x", b"rar")), "Compression 'rar' is not supported"),
    "bz2 that is none": (lambda: bag(chunk_of(b"x" * 40, b"bz2")), "chunk of bz2 is damaged"),
    "bz2 that holds too much": (lambda: bag(chunk_of(bz2.compress(bytes(5 << 20)), b"bz2")), "holds more"),
    "bz2 cut off": (
        lambda: bag(chunk_of(bz2.compress(bytes(range(256)) * 99)[:60], b"bz2", 25344)),
        "bytes but holds",
    ),
    "lz4 that is none": (lambda: bag(chunk_of(b"x" * 40, b"lz4")), "chunk of lz4 is damaged"),
    "a chunk that is too large": (lambda: bag(chunk_of(bytes(5 << 20))), "more than the"),
    "a chunk of text": (lambda: bag(chunk_of(b"hello, this is no record")), "no record begins here"),
    "a chunk that breaks off": (lambda: bag(chunk_of(entry(fields(op=b"\2"), bytes(9))[:-2])), "breaks off"),
    "a message without time": (
        lambda: bag(chunk_of(entry(fields(op=b"\2", conn=ZERO), bytes(9)))),
        "field 'time'",
    ),
    "a message of no connection": (
        lambda: bag(chunk_of(entry(fields(op=b"\2", conn=b"\5\0\0\0", time=bytes(8)), b"x"))),
        "connection 5, which is nowhere defined",
    ),
    "a connection without number": (
        lambda: bag(entry(fields(op=b"\7", topic=b"/a"), fields(type=b"std_msgs/String"))),
        "field 'conn'",
    ),
    "a connection without type": (
        lambda: bag(entry(fields(op=b"\7", conn=ZERO, topic=b"/a"), fields(topic=b"/a"))),
        "field 'type'",
    ),
}


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """Small bombs go off as large ones do."""
    for module in ("bounds", "ros1_bag"):
        monkeypatch.setattr(f"magmatch.data.logs.{module}.MAX_CHUNK", 4 << 20)


@pytest.mark.parametrize("case", REFUSED)
def test_a_bag_made_wrong_is_refused(case, tmp_path, refusal):
    make, words = REFUSED[case]
    (tmp_path / "log.bag").write_bytes(make())
    assert words in refusal(tmp_path / "log.bag")


@pytest.mark.parametrize("case", LOST)
def test_what_is_wrong_in_a_recovered_bag_is_said(case, tmp_path, refusal):
    make, words = LOST[case]
    (tmp_path / "log.bag").write_bytes(make())
    log = open_log(tmp_path / "log.bag", recover=True)
    losses = [loss.text for loss in log.losses()]
    log.close()
    assert len(losses) == 1
    assert words in losses[0]
    refusal(tmp_path / "log.bag")


def test_a_bomb_is_refused(made, flight, tmp_path, refusal):
    (tmp_path / "log.bag").write_bytes(bomb())
    assert "zip bomb" in refusal(tmp_path / "log.bag", recover=True)


def test_a_chunk_that_became_a_bomb_is_refused(made, flight, tmp_path, refusal):
    """Its index is whole."""
    path = made.WRITERS["ROS 1 bag, bz2"](tmp_path, flight.series)
    raw = path.read_bytes()
    start = raw.index(b"BZh")
    packed = bz2.compress(bytes(5 << 20))
    path.write_bytes(raw[:start] + packed + raw[start + len(packed) :])
    assert "holds more" in refusal(path)


@pytest.mark.parametrize("size", [300, *((1 << 20) - k for k in (130, 60, 10, 4, 0, -3))])
def test_reading_goes_on_at_the_very_next_chunk_behind_a_hole(size, tmp_path):
    """Random bytes hold no header; the mark of a chunk among them is none either."""
    hole = np.random.default_rng(size).integers(1, 256, size, dtype=np.uint8).tobytes()
    hole = hole[: size // 2] + b"\x04\x00\x00\x00op=\x05" + hole[size // 2 :]
    connection = entry(
        fields(op=b"\7", conn=ZERO, topic=b"/mag"),
        fields(topic=b"/mag", type=b"sensor_msgs/MagneticField", md5sum=b"0", message_definition=b"x"),
    )

    def three(second):
        stamps = (struct.pack("<II", second + k, 5) for k in range(3))
        return chunk_of(b"".join(entry(fields(op=b"\2", conn=ZERO, time=stamp), b"x") for stamp in stamps))

    head = bag(connection, three(100))
    (tmp_path / "log.bag").write_bytes(head + hole + three(200))
    log = open_log(tmp_path / "log.bag", recover=True)
    try:
        times = [t for _, t, _ in log.messages({"/mag"})]
        assert times == [second * 10**9 + 5 for second in (100, 101, 102, 200, 201, 202)]
        assert [(loss.start, loss.stop) for loss in log.losses()] == [(len(head), len(head) + len(hole))]
    finally:
        log.close()
