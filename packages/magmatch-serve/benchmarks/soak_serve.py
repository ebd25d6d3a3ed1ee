# SPDX-License-Identifier: BSD-3-Clause
"""Hours of samples through a service that is killed again and again: what is lost, and whether memory grows.

Clients walk through one hall as fast as the service answers, each a walk of its own and with some samples under way.
Another posts whole logs to /localize and /register, each of another walk. Now and then one of the processes is killed
(-9): the service itself, one that follows clients, or one that works on logs. Counted are answers, states that
resumed, samples that had to be sent again (those since the last checkpoint), poses farther from the truth than five
standard deviations, which another's pose would be, logs that were answered, refused or cut off, and resident memory
along the way, of each kind of process: of the largest, and by how much one grew after its first hour of samples (of
all clients together, as long as it lived). Those that work on logs have little time beside clients that never rest,
and may still be reading their code by then: ``--logs 160`` posts so many logs, each another walk, to a service
without other clients, and says how its worker grew; nothing else is done. Ends by itself.

Run, with PYTHONPATH=tests:packages/magmatch-serve/tests:
    python packages/magmatch-serve/benchmarks/soak_serve.py [--hours H] [--kills N] [--clients N]
    [--logs N]
"""

import json
import os
import random
import signal
import threading
import time
from collections import Counter
from contextlib import suppress
from http.client import HTTPException
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from bench_serve import children_of, make_map, resident
from websockets.exceptions import WebSocketException

from drifting import Place, drifting_walk
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments
from magmatch_serve.messages import read_pose
from serving import client, packed, samples, serving, wait_until

TRIES = 2000
# Samples that a client has sent and has no answer to yet: with one, both would wait for the way there and back.
UNDER_WAY = 16
RATE = 10.0
# Logs that are posted in turn, s between two, and what is far from the truth, m: some drift more than others.
N_LOGS, PAUSE, FAR = 50, 3.0, 1.0
SERVICE, FOLLOWER, WORKER = "service", "follower of clients", "worker on logs"


class SoakWalker(threading.Thread):
    """A client that sends one walk, and goes on after whatever happens."""

    def __init__(self, seed: int, hours: float, where: dict) -> None:
        super().__init__(daemon=True)
        laps = hours * 3600 / 21
        bias, start = (2e-6, -1e-6, 1e-6), float(seed)
        self.log, self.truth = drifting_walk(Place(1), seed, laps=laps, start=start, bias=bias, turn=0.5)
        self.where, self.key, self.is_done = where, None, False
        self.n_answers = self.n_resumed = self.n_anew = self.n_again = self.n_wrong = self.n_stated = 0
        # When each answer came: what is sent again was answered since the last checkpoint.
        self.came, self.oldest_again = np.full(len(self.log), np.nan), 0.0

    def run(self) -> None:
        """Until all is answered, or too many tries failed."""
        rows, done = list(samples(self.log)), -1
        for _ in range(TRIES):
            talking = client(self.where["service"], self.key, answers="binary")
            with suppress(WebSocketException, OSError, TimeoutError), talking as one:
                wire, welcome = one.socket, one.welcome
                if self.key is not None:
                    self.n_resumed += welcome["resumed"]
                    self.n_anew += not welcome["resumed"]
                self.key = welcome["key"]
                next_row = 0 if welcome["t"] is None else int(np.searchsorted(self.log.times, welcome["t"], "right"))
                if next_row <= done:
                    self.n_again += done + 1 - next_row
                    self.oldest_again = max(self.oldest_again, self.came[done] - self.came[next_row])
                for n in range(next_row, len(rows) + UNDER_WAY):
                    if n < len(rows):
                        wire.send(packed(rows[n]))
                    if (answered := n - UNDER_WAY) >= next_row:
                        self.note(answered, read_pose(wire.recv(timeout=60)))
                        done = max(done, answered)
                self.is_done = True
                return
            time.sleep(1.0)

    def note(self, n: int, said: dict) -> None:
        """Count an answer, and whether its pose is this walk's."""
        self.n_answers += 1
        self.came[n] = time.monotonic()
        if "T_map_body" in said:
            T, C = np.array(said["T_map_body"]), np.array(said["covariance"])
            off = np.linalg.norm(T[:3, 3] - self.truth[n])
            self.n_stated += 1
            self.n_wrong += bool(off > max(5 * np.sqrt(np.linalg.eigvalsh(C[3:, 3:])[-1]), 0.5))


class Poster(threading.Thread):
    """A client that posts whole logs, one after another; whatever is not answered is posted again."""

    def __init__(self, folder: Path, where: dict, n_logs: int = N_LOGS) -> None:
        super().__init__(daemon=True)
        self.where, self.said, self.n_wrong, self.is_over = where, Counter(), 0, False
        self.logs = []
        for seed in range(101, 101 + n_logs):
            log, truth = drifting_walk(Place(1), seed, laps=1.0, start=float(seed), bias=(2e-6, -1e-6, 1e-6))
            log.save(folder / "log.csv")
            self.logs.append(((folder / "log.csv").read_bytes(), log, truth))

    def run(self) -> None:
        """Until told."""
        n = 0
        while not self.is_over:
            content, log, truth = self.logs[n // 2 % len(self.logs)]
            verb = ("localize", "register")[n % 2]
            try:
                status, _, answer = self.where["service"].ask(f"/{verb}", content)
            except (OSError, HTTPException):
                self.said["cut off"] += 1
                time.sleep(1.0)
                continue
            self.said[status] += 1
            if status == 200:
                n += 1
                getattr(self, verb)(json.loads(answer), log, truth)
            time.sleep(PAUSE)

    def localize(self, said: dict, log, truth: np.ndarray) -> None:
        """Poses of a localisation against the truth."""
        rows = np.array(said["trajectory"]).reshape(-1, 8)
        at = np.searchsorted(log.times, rows[:, 0] - 1e-6)
        self.said["poses"] += len(rows)
        self.n_wrong += int((np.linalg.norm(rows[:, 1:4] - truth[at], axis=1) > FAR).sum())

    def register(self, said: dict, log, truth: np.ndarray) -> None:
        """One pose against the truth, where it was accepted: the log drifts, so of its middle."""
        if said["status"] == "accepted":
            T, middle = np.array(said["T_base_target"]), log.positions.mean(axis=0)
            self.said["accepted"] += 1
            self.n_wrong += bool(np.linalg.norm(T[:3, :3] @ middle + T[:3, 3] - truth.mean(axis=0)) > FAR)


def main() -> None:
    # Hours of samples, of all clients together; minutes after which it ends in any case.
    asked = arguments(__doc__, hours=24.0, kills=20, clients=4, minutes=60.0, logs=0, save=saver)
    if asked.logs:
        in_a_row(asked.logs, asked.save)
        return
    rng, where = random.Random(0), {}
    until = time.monotonic() + 60 * asked.minutes
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_map(folder / "hall.map")
        walkers = [SoakWalker(seed, asked.hours / asked.clients, where) for seed in range(1, asked.clients + 1)]
        total, n_kills, killed = sum(len(w.log) for w in walkers), 0, Counter()
        poster = Poster(folder, where)
        memory = Memory(total)
        while any(not w.is_done for w in walkers) and time.monotonic() < until:
            with serving(folder / "hall.map", "--states", folder / "states") as service:
                where["service"] = service
                if not poster.is_alive():
                    poster.start()
                for walker in walkers:
                    if not walker.is_alive() and not walker.is_done:
                        walker.start()
                n_kills += watch(service, walkers, total, asked.kills, n_kills, rng, memory, until, killed)
        poster.is_over = True
    said = poster.said
    rows = [
        ["samples, answers, walks to their end",
         f"{total:,}; {sum(w.n_answers for w in walkers):,}; {sum(w.is_done for w in walkers)} of {len(walkers)}"],
        ["killed", f"{n_kills}: " + ", ".join(f"{kind} {n}" for kind, n in killed.items())],
        ["clients resumed, begun anew", f"{sum(w.n_resumed for w in walkers)}, {sum(w.n_anew for w in walkers)}"],
        ["samples sent again after a kill, the oldest",
         f"{sum(w.n_again for w in walkers):,}, {max(w.oldest_again for w in walkers):.1f} s old"],
        ["poses stated, of these wrong",
         f"{sum(w.n_stated for w in walkers):,}, {sum(w.n_wrong for w in walkers)}"],
        ["logs posted: answered, refused with 503, cut off, else",
         f"{said[200]}, {said[503]}, {said['cut off']}, "
         f"{sum(n for k, n in said.items() if isinstance(k, int) and k not in (200, 503))}"],
        ["poses of logs, registrations accepted, of both wrong",
         f"{said['poses']:,}, {said['accepted']}, {poster.n_wrong}"],
        *memory.rows(),
    ]  # fmt: skip
    show(["what", f"{asked.hours:g} h of samples"], rows, asked.save)


def in_a_row(n_logs: int, save) -> None:
    """Memory of the process that works on logs, by how many it has answered."""
    with TemporaryDirectory() as name:
        folder, sizes, said = Path(name), [], Counter()
        make_map(folder / "hall.map")
        logs = Poster(folder, {}, (n_logs + 1) // 2).logs
        with serving(folder / "hall.map", "--states", folder / "states") as service:
            own = service.process.pid
            for n in range(n_logs):
                said[service.ask(("/localize", "/register")[n % 2], logs[n // 2][0])[0]] += 1
                sizes.append(max(resident(pid) for pid in children_of(own) if kind_of(pid, own) == WORKER))
    eighths = [f"{max(part):.0f}" for part in np.array_split(sizes, 8)]
    rows = [
        ["logs answered", f"{said[200]} of {n_logs}"],
        [f"resident MB of the {WORKER} after 1, 10, 20", ", ".join(f"{sizes[n - 1]:.0f}" for n in (1, 10, 20))],
        ["the most in each eighth of them", ", ".join(eighths)],
    ]
    show(["what", f"{n_logs} logs in a row"], rows, save)


class Memory:
    """Resident memory of every process: its kind, and by answers at each look."""

    def __init__(self, total: int) -> None:
        self.total, self.kinds = total, {}
        self.seen: dict[int, list[tuple[int, float]]] = {}

    def look(self, service, n_answers: int) -> None:
        """Note all processes of the service."""
        own = service.process.pid
        for pid in [own, *children_of(own)]:
            with suppress(OSError):
                if kind := kind_of(pid, own):
                    self.kinds[pid] = kind
                    self.seen.setdefault(pid, []).append((n_answers, resident(pid)))

    def rows(self) -> list[list[str]]:
        """Of each kind: the largest process in each twelfth of the samples, and growth after a first hour."""
        found, hour = [], RATE * 3600
        for kind in (SERVICE, FOLLOWER, WORKER):
            parts, grown, longest = {}, [], 0.0
            for rows in (rows for pid, rows in self.seen.items() if self.kinds[pid] == kind):
                for n, mb in rows:
                    part = min(12 * n // self.total, 11)
                    parts[part] = max(parts.get(part, 0.0), mb)
                if later := [mb for n, mb in rows if n >= rows[0][0] + hour]:
                    grown.append(max(later) - later[0])
                    longest = max(longest, (rows[-1][0] - rows[0][0]) / hour)
            sizes = ", ".join(f"{mb:.0f}" for _, mb in sorted(parts.items()))
            found.append([f"resident MB, largest {kind} in each twelfth of the samples", sizes])
            growth = (
                f"{max(grown):.1f} MB ({len(grown)} processes, one for {longest:.1f} h)" if grown else "none so old"
            )
            found.append([f"growth after its first hour of samples, the most of one {kind}", growth])
        return found


def kind_of(pid: int, own: int) -> str | None:
    """What a process of the service does; None of Python's own helpers."""
    if pid == own:
        return SERVICE
    with suppress(OSError):
        if b"spawn_main" not in Path(f"/proc/{pid}/cmdline").read_bytes():
            return None
        # Those that work on logs let others go first (nice).
        is_worker = os.getpriority(os.PRIO_PROCESS, pid) > os.getpriority(os.PRIO_PROCESS, own)
        return WORKER if is_worker else FOLLOWER
    return None


def watch(service, walkers, total, most, n_before, rng, memory, until, killed) -> int:
    """Kill a process each time that a share of all is answered; gives the kills. The service's own ends the watch."""
    n = 0
    while any(not w.is_done for w in walkers) and time.monotonic() < until:
        time.sleep(0.5)
        n_answers, own = sum(w.n_answers for w in walkers), service.process.pid
        memory.look(service, n_answers)
        share = n_answers / total
        if share * (most + 1) < n_before + n + 1 or n_before + n >= most:
            continue
        n += 1
        if rng.random() < 0.3:
            service.process.kill()
            killed[SERVICE] += 1
            return n
        kinds = {pid: kind for pid in children_of(own) if (kind := kind_of(pid, own))}
        victim = rng.choice(list(kinds))
        killed[kinds[victim]] += 1
        with suppress(OSError):
            os.kill(victim, signal.SIGKILL)
        wait_until(lambda: service.ask("/health")[0] == 200)
    return n


if __name__ == "__main__":
    main()
