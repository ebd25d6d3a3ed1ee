# SPDX-License-Identifier: BSD-3-Clause
"""Connections that only take room are cut off: no request, or nothing taken of what waits for them."""

import json
import os
import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from time import monotonic

import pytest

from serving import wait_until

HELLO, PING = b'{"type": "hello"}', b"x" * 125
UPGRADE = (
    b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
HEALTH = b"GET /health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
UPLOAD = b"POST /localize HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 999\r\n\r\nt,x"


def opened(door, words=b""):
    host, port = door.url.removeprefix("http://").split(":")
    wire = socket.create_connection((host, int(port)), timeout=60)
    wire.sendall(words)
    return wire


def frame(kind, content):
    """A client's WebSocket frame of fewer than 126 bytes, its mask zero."""
    return bytes([0x80 | kind, 0x80 | len(content)]) + bytes(4) + content


def test_one_that_asks_nothing_is_cut_off(door):
    with ExitStack() as stack:
        wires = [stack.enter_context(opened(door, words)) for words in (b"", HEALTH[:20], HEALTH + HEALTH[:20])]
        for wire in wires:
            with suppress(ConnectionResetError):
                while wire.recv(4096):
                    pass


def test_pings_of_one_that_never_reads_fill_no_memory(door):
    before = resident(door)
    with opened(door, UPGRADE + frame(1, HELLO)) as wire, pytest.raises(ConnectionError):
        flood(wire, until=monotonic() + 120)
    assert resident(door) - before < 20e6


def flood(wire, until):
    while monotonic() < until:
        wire.sendall(frame(9, PING) * 500)


def test_logs_that_are_being_sent_count_as_logs(door):
    with ExitStack() as stack:
        for _ in range(8):  # max_logs
            stack.enter_context(opened(door, UPLOAD))
        status, _, said = wait_until(lambda: (found := door.ask("/localize", b"x"))[0] == 503 and found)
        assert (status, json.loads(said)["status"]) == (503, 503)
    assert wait_until(lambda: door.ask("/localize", b"x")[0] == 422)


def resident(service):
    """Bytes of memory that the service's own process holds."""
    pages = Path(f"/proc/{service.process.pid}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
