# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 bags made wrong by hand, by name: each is refused in one line that says what is wrong."""

import bz2
import struct

import pytest


def fields(**values):
    return b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in values.items())


def entry(head, data=b""):
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag(*entries, index_pos=1, **header):
    first = fields(op=b"\3", index_pos=struct.pack("<Q", index_pos), **header)
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
    "bz2 that holds more than it declares": (
        lambda: bag(chunk_of(bz2.compress(bytes(5 << 20)), b"bz2", size=1000)),
        "holds more",
    ),
    "a bomb of bz2": (bomb, "zip bomb"),
    "bz2 cut off": (
        lambda: bag(chunk_of(bz2.compress(bytes(range(256)) * 99)[:60], b"bz2", size=256 * 99)),
        "declares 25344 bytes but holds",
    ),
    "lz4 that is none": (
        lambda: bag(chunk_of(b"x" * 40, b"lz4", size=99)),
        "lz4 chunk is damaged",
    ),
    "a chunk stored with another size": (
        lambda: bag(chunk_of(b"x" * 40, b"none", size=41)),
        "bytes but holds",
    ),
    "a chunk of text": (lambda: bag(chunk_of(b"hello, this is no record", b"none")), "breaks off"),
    "a record without operation": (lambda: bag(entry(fields(conn=ZERO))), "no record begins here"),
    "an index without its connection": (
        lambda: bag(entry(fields(op=b"\4", ver=b"\1\0\0\0", count=ZERO))),
        "without its conn",
    ),
    "a name of a field without end": (lambda: bag(entry(struct.pack("<I", 1 << 30) + b"op=")), "header is damaged"),
    "a connection without number": (
        lambda: bag(entry(fields(op=b"\7", topic=b"/a"), fields(type=b"std_msgs/String"))),
        "without number or type",
    ),
    "a message of no connection": (
        lambda: bag(chunk_of(entry(fields(op=b"\2", conn=b"\5\0\0\0", time=bytes(8)), b"x"))),
        "channel 5, which is nowhere defined",
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
def test_a_bag_made_wrong_is_refused(case, tmp_path, refusal, monkeypatch):
    monkeypatch.setattr("magmatch.data.logs.bounds.MAX_CHUNK", 4 << 20)  # small bombs go off as large ones do
    make, words = BAGS[case]
    (tmp_path / "log.bag").write_bytes(make())
    assert words in refusal(tmp_path / "log.bag")
