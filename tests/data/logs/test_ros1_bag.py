# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 bags made wrong by hand, by name: refused in one line that says what is wrong."""

import struct

import pytest


def fields(**values):
    return b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in values.items())


def entry(head, data=b""):
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag(*entries, index_pos=1, **header):
    counts = {"conn_count": b"\1\0\0\0", "chunk_count": b"\1\0\0\0"} | header
    first = fields(op=b"\3", index_pos=struct.pack("<Q", index_pos), **counts)
    return b"#ROSBAG V2.0\n" + entry(first) + b"".join(entries)


def chunk_of(raw):
    return entry(fields(op=b"\5", compression=b"none", size=struct.pack("<I", len(raw))), raw)


ZERO = bytes(4)
REFUSED = {
    "version 1.2": (lambda: b"#ROSBAG V1.2\n" + bytes(99), "expected a bag of version 2.0, found '#ROSBAG V1.2'"),
    "encrypted": (lambda: bag(encryptor=b"aes"), "Bag encryption 'aes' is not supported"),
    "never closed": (lambda: bag(index_pos=0), "Bag is not indexed"),
    "index behind the end": (lambda: bag(index_pos=10**9), "index looks damaged"),
    "index behind any end": (lambda: bag(index_pos=(1 << 63) - 1), "rosbag reindex mends it"),
    "index beyond all numbers": (lambda: bag(index_pos=(1 << 64) - 1), "rosbag reindex mends it"),
    "another first record": (lambda: b"#ROSBAG V2.0\n" + entry(fields(op=b"\2")), "'MSGDATA' is unexpected"),
    "a header of gigabytes": (lambda: b"#ROSBAG V2.0\n\xff\xff\xff\x7f", "rosbag reindex mends it"),
    "no records": (lambda: bag(chunk_count=ZERO), "expected a field topic"),
    "an index of something else": (lambda: bag(chunk_of(b"x" * 99), index_pos=99), "index looks damaged"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_bag_made_wrong_is_refused(case, tmp_path, refusal):
    make, words = REFUSED[case]
    (tmp_path / "log.bag").write_bytes(make())
    assert words in refusal(tmp_path / "log.bag")
