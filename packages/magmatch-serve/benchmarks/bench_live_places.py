# SPDX-License-Identifier: BSD-3-Clause
"""A folder of many maps behind the live door: until bodies are found in it, and what others wait meanwhile.

FOLDER is that of ``many_buildings.py``, with CEA's map in it. Walks are stretches of CEA's second walk at 1 m/s with
odometry that drifts and a sensor with a bias, 20 samples a second. Other clients, on the other floor at 50 Hz, walk
beside them; their waits are from a sample's send to its answer. A pose in another map, or more than 1 m from the
truth, is wrong. Ends by itself.

The walks are followed first without the service, each sample waiting for all work that it begins: where the method
finds a body, whatever the machine's speed. Live, samples do not wait, and a late search counts as path walked.
``--speed 0.25``: live four times slower than walked. ``--walks 20 --others 0 --speed 0``: the method alone.

Run, with PYTHONPATH=tests:packages/magmatch-serve/tests:benchmarks/experiments:
    python packages/magmatch-serve/benchmarks/bench_live_places.py FOLDER [--walks N]
    [--others N] [--length M] [--speed X]
"""

import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from bench_serve import children_of, cpu_of, resident
from short_walks import stretches

from drifting import about_z
from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import path_walked
from magmatch.localization.known_places import KnownPlaces, open_place
from magmatch.localization.localizer import Localizer
from magmatch.simulation.paths import heading_along
from magmatch_evaluation.script import arguments
from magmatch_serve.messages import pose_document, read_pose, read_samples, write_sample
from serving import client, serving

PLACE, FAR, SETTLE = "cea.map", 1.0, 30.0
RATE, STEP = 20.0, 0.05
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


class BuildingWalker(threading.Thread):
    """A client that sends a sample when its time has come, and the next once it is answered."""

    def __init__(self, service, samples: list[bytes], rate: float) -> None:
        super().__init__(daemon=True)
        self.service, self.samples, self.rate, self.is_over = service, samples, rate, False
        self.said: list[dict] = []
        self.sent: list[float] = []
        self.waits: list[float] = []

    def run(self) -> None:
        """Send all."""
        with client(self.service) as one:
            begin = time.perf_counter()
            for n, sample in enumerate(self.samples):
                if self.is_over:
                    return
                time.sleep(max(begin + n / self.rate - time.perf_counter(), 0.0))
                self.sent.append(time.perf_counter())
                one.socket.send(sample)
                self.said.append(read_pose(one.socket.recv(timeout=60)))
                self.waits.append(time.perf_counter() - self.sent[-1])


def main() -> None:
    asked = arguments(__doc__, (), recordings=None, walks=5, others=3, length=15.0, speed=1.0, seed=2007)
    rng, walks = np.random.default_rng(asked.seed), load_recordings("cea", asked.recordings)
    targets = [drifting(s, STEP, rng) for s in stretches(walks["test-floor2"], asked.length, asked.walks, rng)]
    beside = [drifting(s, 0.02, rng)[0] for s in stretches(walks["test-floor1"], 100.0, asked.others, rng)]
    begin = time.perf_counter()
    known = KnownPlaces(open_place(Path(asked.words[0])))
    print(f"{len(known.entries)} maps, open after {time.perf_counter() - begin:.1f} s", flush=True)
    print(summary("the method alone", [alone(known, *target) for target in targets]), flush=True)
    if asked.speed > 0:
        live(asked, targets, beside)


def live(asked, targets: list, beside: list) -> None:
    """The same walks through the service, beside others."""
    begin = time.perf_counter()
    with TemporaryDirectory() as name, serving(asked.words[0], "--states", Path(name) / "states") as service:
        print(f"ready after {time.perf_counter() - begin:.1f} s; {memory(service)}")
        others = [BuildingWalker(service, samples, 50.0) for samples in beside]
        for one in others:
            one.start()
        time.sleep(SETTLE if others else 0.0)
        print(f"the others, {SETTLE:.0f} s on: {waits(others, time.perf_counter() - 5.0)}", flush=True)
        rate = RATE * asked.speed
        outcomes = [follow(service, samples, truth, others, rate) for samples, truth in targets]
        print(summary(f"live at {asked.speed:g} times the walk's speed", outcomes))
        for one in others:
            one.is_over = True
        print(memory(service))


def alone(known: KnownPlaces, samples: list[bytes], truth: np.ndarray) -> "Outcome":
    """Follow a walk in this process, each sample waiting for what it begins."""
    one, said, begin = Localizer(known), [], time.process_time()
    for n, sample in enumerate(samples):
        (t,), (T,), (field,) = read_samples(sample, 1)
        one.update_by_matrix(float(t), T, field)
        said.append(pose_document(n, STEP * n, one.estimate()))
    outcome = Outcome.of(said, truth, time.process_time() - begin)
    print(outcome, flush=True)
    return outcome


def follow(service, samples: list[bytes], truth: np.ndarray, others: list[BuildingWalker], rate: float) -> "Outcome":
    """Send one walk, and say how it went."""
    one, before, begin = BuildingWalker(service, samples, rate), cpu_of(service), time.perf_counter()
    one.start()
    one.join()
    spent = sum(after - before.get(key, 0.0) for key, after in cpu_of(service).items())
    outcome = Outcome.of(one.said, truth, spent)
    late = (one.sent[-1] - one.sent[0]) - (len(samples) - 1) / rate
    print(
        f"{outcome}, others' share included; its longest wait {1e3 * max(one.waits):.0f} ms, {late:.1f} s behind at "
        f"its end; others: {waits(others, begin)}", flush=True
    )  # fmt: skip
    return outcome


class Outcome(NamedTuple):
    """How one walk went: path until it was found (m, inf where not), samples, poses, wrong ones, s of processor."""

    found: float
    n: int
    n_stated: int
    n_wrong: int
    seconds: float

    @classmethod
    def of(cls, said: list[dict], truth: np.ndarray, seconds: float) -> "Outcome":
        """Answers to all samples against the truth."""
        stated = [n for n, one in enumerate(said) if "T_map_body" in one]
        off = [np.linalg.norm(np.array(said[n]["T_map_body"])[:3, 3] - truth[n]) for n in stated]
        wrong = sum(d > FAR or said[n]["map"] != PLACE for n, d in zip(stated, off, strict=True))
        return cls(STEP * stated[0] if stated else np.inf, len(truth), len(stated), wrong, seconds)

    def __str__(self) -> str:
        place = f"found after {self.found:.1f} m" if np.isfinite(self.found) else "not found"
        return (
            f"{place}, {self.n_stated} of {self.n} samples with a pose, {self.n_wrong} wrong; "
            f"{self.seconds:.1f} s of processor"
        )


def summary(what: str, outcomes: list[Outcome]) -> str:
    """All walks in a line."""
    found = sorted(one.found for one in outcomes if np.isfinite(one.found))
    after = f", after {np.median(found):.1f} m (median; {found[0]:.1f} to {found[-1]:.1f})" if found else ""
    total, wrong = sum(one.n_stated for one in outcomes), sum(one.n_wrong for one in outcomes)
    seconds = np.median([one.seconds for one in outcomes])
    return (
        f"{what}: {len(found)} of {len(outcomes)} walks found{after}; {wrong} of {total} poses wrong, in "
        f"{sum(one.n_wrong > 0 for one in outcomes)} walks; {seconds:.1f} s of processor a walk (median)"
    )


def waits(walkers: list[BuildingWalker], since: float) -> str:
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
