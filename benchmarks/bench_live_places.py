# SPDX-License-Identifier: BSD-3-Clause
"""A folder of many maps behind the live door: until bodies are found in it, and what others wait meanwhile.

FOLDER is that of ``many_buildings.py``, with CEA's map in it. Walks are stretches of CEA's second walk at 1 m/s with
odometry that drifts and a sensor with a bias, 20 samples a second. Other clients, on the other floor at 50 Hz, walk
beside them; their waits are from a sample's send to its answer. A pose in another map, or more than 1 m from the
truth, is wrong. Ends by itself.

Run: PYTHONPATH=tests:benchmarks:benchmarks/experiments python benchmarks/bench_live_places.py FOLDER [--walks N]
"""

import json
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from bench_serve import children_of, cpu_of, resident
from short_walks import stretches
from websockets.sync.client import connect

from drifting import about_z
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import path_walked
from magmatch.serve.messages import read_pose, write_sample
from magmatch.simulation.paths import heading_along
from magmatch_evaluation.script import arguments
from serving import serving

PLACE, FAR, SETTLE = "cea.map", 1.0, 30.0
BIAS = np.array([2e-6, -1e-6, 1e-6])


def drifting(walk: Survey, step: float, rng: np.random.Generator) -> tuple[list[bytes], np.ndarray]:
    """Samples of a stretch as odometry has it, one each `step` m and so many s, and the true positions."""
    arc = path_walked(walk.positions)
    t = np.arange(0.0, arc[-1], step)
    p, b = (np.column_stack([np.interp(t, arc, x) for x in rows.T]) for rows in (walk.positions, walk.field))
    R, steps = about_z(heading_along(p)), np.diff(p, axis=0)
    turns = np.cumsum(np.radians(1.0) * np.sqrt(np.linalg.norm(steps, axis=1)) * rng.standard_normal(len(steps)))
    drift = about_z(rng.uniform(0, 2 * np.pi) + np.concatenate([[0.0], turns]))
    walked = np.concatenate([np.zeros((1, 3)), np.cumsum(1.01 * drift[:-1].apply(steps), axis=0)])
    rows = zip(t, walked, (drift * R).as_quat(), R.inv().apply(b) + BIAS, strict=True)
    return [write_sample(*row) for row in rows], p


class Walker(threading.Thread):
    """A client that sends a sample when its time has come, and the next once it is answered."""

    def __init__(self, live: str, samples: list[bytes], rate: float) -> None:
        super().__init__(daemon=True)
        self.live, self.samples, self.rate, self.is_over = live, samples, rate, False
        self.said: list[dict] = []
        self.sent: list[float] = []
        self.waits: list[float] = []

    def run(self) -> None:
        """Send all."""
        with connect(self.live, proxy=None, compression=None) as wire:
            wire.send(json.dumps({"type": "hello"}))
            wire.recv(timeout=60)
            begin = time.perf_counter()
            for n, sample in enumerate(self.samples):
                if self.is_over:
                    return
                time.sleep(max(begin + n / self.rate - time.perf_counter(), 0.0))
                self.sent.append(time.perf_counter())
                wire.send(sample)
                self.said.append(read_pose(wire.recv(timeout=60)))
                self.waits.append(time.perf_counter() - self.sent[-1])


def main() -> None:
    asked = arguments(__doc__, (), recordings=None, walks=5, others=3, length=15.0, seed=2007)
    rng, walks = np.random.default_rng(asked.seed), load_recordings("cea", asked.recordings)
    targets = [drifting(s, 0.05, rng) for s in stretches(walks["test-floor2"], asked.length, asked.walks, rng)]
    beside = [drifting(s, 0.02, rng)[0] for s in stretches(walks["test-floor1"], 100.0, asked.others, rng)]
    begin = time.perf_counter()
    with TemporaryDirectory() as name, serving(asked.words[0], "--states", Path(name) / "states") as service:
        print(f"ready after {time.perf_counter() - begin:.1f} s; {memory(service)}")
        others = [Walker(service.live, samples, 50.0) for samples in beside]
        for one in others:
            one.start()
        time.sleep(SETTLE if others else 0.0)
        print(f"the others, {SETTLE:.0f} s on: {waits(others, time.perf_counter() - 5.0)}", flush=True)
        for samples, truth in targets:
            print(follow(service, samples, truth, others), flush=True)
        for one in others:
            one.is_over = True
        print(memory(service))


def follow(service, samples: list[bytes], truth: np.ndarray, others: list[Walker]) -> str:
    """Send one walk, and say how it went."""
    one, before, begin = Walker(service.live, samples, 20.0), cpu_of(service), time.perf_counter()
    one.start()
    one.join()
    stated = [n for n, said in enumerate(one.said) if "T_map_body" in said]
    off = [np.linalg.norm(np.array(one.said[n]["T_map_body"])[:3, 3] - truth[n]) for n in stated]
    wrong = sum(d > FAR or one.said[n]["map"] != PLACE for n, d in zip(stated, off, strict=True))
    found = f"found after {0.05 * stated[0]:.1f} m" if stated else "not found"
    spent = sum(after - before.get(key, 0.0) for key, after in cpu_of(service).items())
    return (
        f"{found}, {len(stated)} of {len(truth)} samples with a pose, {wrong} wrong; its longest wait "
        f"{1e3 * max(one.waits):.0f} ms; {spent:.1f} s of processor, others' share included; others: "
        f"{waits(others, begin)}"
    )


def waits(walkers: list[Walker], since: float) -> str:
    """Median, 99 % and longest since then, ms."""
    some = [w for one in walkers for at, w in zip(one.sent, one.waits, strict=False) if at >= since]
    if not some:
        return "none"
    return "median {:.1f}, 99 % {:.1f}, longest {:.0f} ms".format(*1e3 * np.quantile(some, [0.5, 0.99, 1.0]))


def memory(service) -> str:
    """Resident MB of each process; most of it pages of files, which they share."""
    pids = [service.process.pid, *children_of(service.process.pid)]
    return "resident MB " + ", ".join(f"{resident(pid):.0f}" for pid in pids)


if __name__ == "__main__":
    main()
