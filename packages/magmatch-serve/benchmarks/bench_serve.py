# SPDX-License-Identifier: BSD-3-Clause
"""A service with many clients on this machine: what a sample costs, and how long an answer takes.

Clients walk at 1 m/s through one hall by odometry that drifts, each at 50 Hz in the binary form, from one process of
its own. A wait is from the write of a sample to the read of its answer. Three rounds: a few clients (the cost of a
sample), all of them, and all beside ten that misbehave (rubbish, never reading, connecting in a loop). Each round
ends by itself; the clients' processor time is said apart, as it is taken from the same cores.

Run, with PYTHONPATH=tests:packages/magmatch-serve/tests:
    python packages/magmatch-serve/benchmarks/bench_serve.py [--clients N] [--seconds S] [--trackers N]
"""

import asyncio
import json
import os
import random
import struct
import time
from collections import deque
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import Slerp

import magmatch as mm
from drifting import Place, drifting_walk
from magmatch_evaluation.script import arguments
from magmatch_serve.messages import POSE, SAMPLE, STATUSES
from serving import serving

RATE, N_WALKS, N_BAD = 50.0, 10, 10
TICK = os.sysconf("SC_CLK_TCK")
LEAVE_WITHIN = 10.0


def main() -> None:
    asked = arguments(__doc__, clients=100, seconds=600.0, trackers=2)
    seconds = asked.seconds
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_map(folder / "hall.map")
        walks = [packed_walk(seed, seconds) for seed in range(1, N_WALKS + 1)]
        (folder / "settings.yaml").write_text(f"trackers: {asked.trackers}\nmax_connects: 1000000\n")
        print("round           clients  samples  answered  refused  wait ms: median    p90    p99    most  "
              "us a sample: service  trackers  (clients)  stated  MB")  # fmt: skip
        few = max(min(asked.clients, 10), 1)
        rounds = [("few", few, 0, min(seconds, 30.0)), ("all", asked.clients, 0, seconds)]
        rounds.append(("beside bad ones", asked.clients, N_BAD, min(seconds, 120.0)))
        for kind, n, n_bad, length in rounds:
            with serving(folder / "hall.map", "--config", folder / "settings.yaml") as service:
                print(f"{kind:15s} {asyncio.run(run(service, walks, n, n_bad, length))}", flush=True)


def make_map(path: Path) -> None:
    """The hall, surveyed along four laps."""
    _, truth = drifting_walk(Place(1), 7, laps=4.0)
    noise = 2e-7 * np.random.default_rng(7).standard_normal(truth.shape)
    mm.build_map(mm.Survey(truth, Place(1).field(truth) + noise, name="hall")).save(path)


def packed_walk(seed: int, seconds: float) -> list[bytes]:
    """Frames of a walk at 50 Hz: a masked WebSocket frame each, its mask zero."""
    laps = seconds / 21 + 0.1
    log, _ = drifting_walk(Place(1), seed, laps=laps, start=float(seed), bias=(2e-6, -1e-6, 1e-6), turn=0.5)
    t = np.arange(0, log.times[-1], 1 / RATE)
    p = np.column_stack([np.interp(t, log.times, x) for x in log.positions.T])
    body = log.orientations.inv().apply(log.field)
    b = np.column_stack([np.interp(t, log.times, x) for x in body.T])
    q = Slerp(log.times, log.orientations)(t).as_quat()
    rows = np.zeros(len(t), SAMPLE)
    rows["t"], rows["pqb"] = t, np.column_stack([p, q, b])
    return [frame(row.tobytes()) for row in rows]


def frame(content: bytes, kind: int = 2) -> bytes:
    """A client's WebSocket frame."""
    n = len(content)
    length = struct.pack("!BB", 0x80 | kind, 0x80 | n) if n < 126 else struct.pack("!BBH", 0x80 | kind, 0xFE, n)
    return length + bytes(4) + content


class Walker(asyncio.Protocol):
    """A client that sends a frame each 20 ms and notes when its answers come."""

    def __init__(self, frames: list[bytes], host: str, said: dict) -> None:
        self.frames, self.host, self.said = frames, host, said
        self.sent: deque[float] = deque()
        self.waits: list[float] = []
        self.n_sent = self.n_refused = self.n_stated = 0
        self.buffer, self.is_open = b"", False
        self.welcomed = asyncio.get_running_loop().create_future()

    def connection_made(self, transport) -> None:
        """Ask for a WebSocket."""
        self.transport = transport
        words = f"GET /live HTTP/1.1\r\nHost: {self.host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        words += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        transport.write(words.encode())

    def data_received(self, data: bytes) -> None:
        """Cut what comes into frames."""
        self.buffer += data
        if not self.is_open:
            head, mark, rest = self.buffer.partition(b"\r\n\r\n")
            if not mark:
                return
            if b" 101 " not in head:  # the bad ones may well be refused; who is none is then missed
                self.transport.abort()
                return
            self.buffer, self.is_open = rest, True
            self.transport.write(frame(json.dumps({"type": "hello", **self.said}).encode(), 1))
        while len(self.buffer) >= 2:
            kind, n, start = self.buffer[0] & 15, self.buffer[1] & 127, 2
            if n == 126:
                n, start = int.from_bytes(self.buffer[2:4], "big"), 4
            if len(self.buffer) < start + n:
                return
            content, self.buffer = self.buffer[start : start + n], self.buffer[start + n :]
            self.take(kind, content)

    def take(self, kind: int, content: bytes) -> None:
        """Note an answer."""
        if kind == 9:
            self.transport.write(frame(content, 10))
        elif kind == 2:
            self.waits.append(time.perf_counter() - self.sent.popleft())
            self.n_stated += STATUSES[POSE.unpack_from(content)[1]].value == "localized"
        elif kind == 1:
            said = json.loads(content)
            if said["type"] == "welcome":
                self.welcomed.set_result(said)
            else:
                self.sent.popleft()
                self.n_refused += 1

    async def walk(self, begin: float, end: float) -> None:
        """Send each frame when its time has come."""
        loop = asyncio.get_running_loop()
        for n, one in enumerate(self.frames):
            due = begin + n / RATE
            if due > end or self.transport.is_closing():
                break
            if due > loop.time():
                await asyncio.sleep(due - loop.time())
            self.sent.append(time.perf_counter())
            self.transport.write(one)
            self.n_sent += 1
        until = loop.time() + LEAVE_WITHIN
        while self.sent and loop.time() < until:
            await asyncio.sleep(0.05)
        self.transport.close()


async def run(service, walks: list[list[bytes]], n: int, n_bad: int, seconds: float) -> str:
    """A round, and its row."""
    loop, (host, port) = asyncio.get_running_loop(), urlsplit(service.url).netloc.split(":")
    before, own = cpu_of(service), time.process_time()
    bad = [asyncio.create_task(misbehave(k, host, port, seconds, walks[0])) for k in range(n_bad)]
    said = {"answers": "binary"}
    walkers = [
        (await loop.create_connection(lambda k=k: Walker(walks[k % N_WALKS], host, said), host, int(port)))[1]
        for k in range(n)
    ]
    await asyncio.wait_for(asyncio.gather(*(w.welcomed for w in walkers)), 60)
    begin = loop.time() + 0.2
    await asyncio.gather(*(w.walk(begin + k / n / RATE, begin + seconds) for k, w in enumerate(walkers)))
    after, own = cpu_of(service), time.process_time() - own
    await asyncio.gather(*bad)
    waits = 1e3 * np.concatenate([w.waits for w in walkers])
    sent, refused = sum(w.n_sent for w in walkers), sum(w.n_refused for w in walkers)
    spent = {key: 1e6 * (after[key] - before.get(key, 0.0)) / max(len(waits), 1) for key in ("service", "trackers")}
    q = np.quantile(waits, [0.5, 0.9, 0.99, 1.0])
    stated = sum(w.n_stated for w in walkers) / max(len(waits), 1)
    return (
        f"{n:7d}  {sent:7d}  {len(waits):8d}  {refused:7d}  {q[0]:16.1f} {q[1]:6.1f} {q[2]:6.1f} {q[3]:7.1f}  "
        f"{spent['service']:20.0f}  {spent['trackers']:8.0f}  {1e6 * own / max(len(waits), 1):9.0f}  {stated:5.0%}  "
        f"{sum(map(resident, [service.process.pid, *children_of(service.process.pid)])):.0f}"
    )


async def misbehave(k: int, host: str, port: str, seconds: float, frames: list[bytes]) -> None:
    """One bad client, until the round is over: rubbish, never reading, or connecting in a loop."""
    rng, loop = random.Random(k), asyncio.get_running_loop()
    end = loop.time() + seconds
    while loop.time() < end:
        protocol = Walker(frames, host, {})
        try:
            transport, _ = await loop.create_connection(lambda protocol=protocol: protocol, host, int(port))
        except OSError:
            await asyncio.sleep(0.5)
            continue
        protocol.take = lambda *_: None
        until = min(end, loop.time() + 20)
        if k % 3 == 0:  # rubbish
            while loop.time() < until and not transport.is_closing():
                transport.write(frame(rng.randbytes(rng.randrange(120))))
                await asyncio.sleep(0.01)
        elif k % 3 == 1:  # never reads
            transport.pause_reading()
            n = 0
            while loop.time() < until and not transport.is_closing():
                if transport.get_write_buffer_size() < 1 << 20:
                    transport.write(b"".join(frames[n : n + 20]))
                    n = (n + 20) % len(frames)
                await asyncio.sleep(0.01)
        else:  # connects in a loop
            await asyncio.sleep(0.05)
        transport.abort()


def cpu_of(service) -> dict[str, float]:
    """Seconds of processor that the service and its children have taken."""
    own = service.process.pid
    spent = {"service": of_process(own)}
    spent["trackers"] = sum(of_process(pid) for pid in children_of(own))
    return spent


def of_process(pid: int) -> float:
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / TICK


def children_of(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def resident(pid: int) -> float:
    """MB of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
