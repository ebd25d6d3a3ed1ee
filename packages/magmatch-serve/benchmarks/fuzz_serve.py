# SPDX-License-Identifier: BSD-3-Clause
"""Mutated bodies, paths and frames against a service: which statuses they get, and whether any says too much.

Counted are answers by status, those of 500, words of this machine (paths, tracebacks) in what is said, and processes
that had to be started again. The same seed sends the same.

Run, with PYTHONPATH=tests:packages/magmatch-serve/tests:
    python packages/magmatch-serve/benchmarks/fuzz_serve.py MAP [--n N] [--seed S] [--save NAME]
"""

import gzip
import json
import random
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments
from magmatch_serve.messages import write_sample
from serving import Service, serving

TOO_MUCH = "says too much"
LEAKS = ("Traceback", "/tmp/", "/root", "/home", ".py", "site-packages", 'File "')
ROW = "{},{},0,0,2e-5,0,-4e-5,0,0,0,1\n"
TABLE = "t,x,y,z,bx,by,bz,qx,qy,qz,qw\n" + "".join(ROW.format(k, k / 10) for k in range(40))
SAMPLE = {"t": 1.0, "position": [0, 0, 0], "orientation": [0, 0, 0, 1], "field": [2e-5, 0, 4e-5]}
ODD = (None, True, -1, 0, 0.5, 1e-300, 1e308, -1e15, 10**40, float("nan"), float("inf"), "", "0", "\0", [], {}, [[1]])
HELLO = json.dumps({"type": "hello"})
PATHS = ("/maps/{}", "/{}", "/localize?{}=1", "/register?seed={}", "/maps/{}/..")
SETTINGS = "max_requests: 10000000\nmax_connects: 10000000\nmax_mistakes: 1000\npatience: 5\nmax_work_time: 20\n"
SAMPLES, HELLOS, QUERIES, LOGS = "samples", "hellos", "paths and queries", "logs, a third of them gzip"
COLUMNS = ["what", "n", "answers", "wrong"]


def main() -> None:
    asked = arguments(__doc__, (), n=10_000, seed=0, save=saver)
    rng, said = random.Random(asked.seed), {kind: Counter() for kind in (SAMPLES, HELLOS, QUERIES, LOGS)}
    with TemporaryDirectory() as folder:
        settings = Path(folder) / "settings.yaml"
        settings.write_text(SETTINGS)
        with serving(asked.words[0], "--config", settings, "--states", Path(folder) / "states") as service:
            fuzz_frames(service, rng, asked.n * 6 // 10, said[SAMPLES])
            fuzz_hellos(service, rng, asked.n // 10, said[HELLOS])
            fuzz_requests(service, rng, asked.n - asked.n * 7 // 10, said)
            metrics = service.ask("/metrics")[2].decode()
            words = service.words()
    restarts = next(line.split()[1] for line in metrics.splitlines() if line.startswith("magmatch_tracker_restarts"))
    rows = []
    for kind, answers in said.items():
        told = "; ".join(f"{answer}: {n:,}" for answer, n in answers.most_common())
        is_wrong = [n for answer, n in answers.items() if answer == "500" or answer.startswith(TOO_MUCH)]
        rows.append([kind, f"{answers.total():,}", told, f"{sum(is_wrong):,}"])
    n_wrong = words.count("Traceback") + int(float(restarts))
    rows.append(["tracebacks in the service's own log, processes started again", "", "", str(n_wrong)])
    show(COLUMNS, rows, asked.save)


def mutated(rng: random.Random, content: bytes) -> bytes:
    """A few bytes changed, cut, doubled or replaced by numbers that are hard to read."""
    made = bytearray(content)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(made) + 1)
        kind = rng.randrange(5)
        if kind == 0:
            made[at : at + 1] = rng.randbytes(1)
        elif kind == 1:
            del made[at : at + rng.randrange(1, 9)]
        elif kind == 2:
            made[at:at] = rng.choice([b"nan", b"1e999", b"-", b",", b"\n", b'"', b"{", b"]", b"\0", b"null", b"\xff"])
        elif kind == 3:
            made[at:at] = made[at // 2 : at]
        else:
            del made[at:]
            made = made or bytearray(b"x")
    return bytes(made)


def frame(rng: random.Random, t: float) -> str | bytes:
    """A message of a time: bytes mutated, JSON with odd parts, or binary rows of odd numbers."""
    kind = rng.randrange(4)
    if kind == 0:
        message = mutated(rng, json.dumps(SAMPLE).encode())
        return message.decode(errors="replace") if rng.random() < 0.7 else message
    if kind == 1:
        row = write_sample(t, np.zeros(3), np.array([0.0, 0, 0, 1]), np.array([2e-5, 0, 4e-5]))
        rows = bytearray(row * rng.randrange(1, 4))
        for _ in range(rng.randrange(3)):
            rows[rng.randrange(len(rows))] = rng.randrange(256)
        return bytes(rows)
    sample = json.loads(json.dumps(SAMPLE | {"t": t}))
    for _ in range(rng.randrange(1, 3)):
        key = rng.choice([*SAMPLE, "samples", "type"])
        inside = sample.get(key)
        if isinstance(inside, list) and inside and rng.random() < 0.7:
            inside[rng.randrange(len(inside))] = rng.choice(ODD)
        else:
            sample[key] = rng.choice(ODD)
    return json.dumps(sample if kind == 2 else {"samples": [sample] * rng.randrange(4)})


def fuzz_frames(service: Service, rng: random.Random, n: int, said: Counter) -> None:
    """Messages after a good hello."""
    wire = None
    for number in range(n):
        try:
            # A time of the far future that is taken makes all later ones late.
            if wire is None or number % 10 == 0:
                if wire is not None:
                    wire.close()
                wire = connect(service.live, proxy=None)
                wire.send(HELLO)
                wire.recv(timeout=60)
            wire.send(frame(rng, float(number)))
            note_message(said, wire.recv(timeout=60))
        except WebSocketException as error:
            note(said, "closed", str(error))
            wire = None
    if wire is not None:
        wire.close()


def fuzz_hellos(service: Service, rng: random.Random, n: int, said: Counter) -> None:
    """First messages."""
    for _ in range(n):
        try:
            with connect(service.live, proxy=None) as wire:
                wire.send(mutated(rng, HELLO.encode()).decode(errors="replace"))
                note_message(said, wire.recv(timeout=60))
        except WebSocketException as error:
            note(said, "closed", str(error))


def fuzz_requests(service: Service, rng: random.Random, n: int, said: dict[str, Counter]) -> None:
    """Paths, words of queries, and bodies."""
    for _ in range(n):
        if rng.random() < 0.4:
            word = "".join(rng.choice("abc%./~?&=;0129") for _ in range(rng.randrange(30)))
            status, _, content = service.ask(rng.choice(PATHS).format(word), rng.choice([None, b"x"]))
            note(said[QUERIES], str(status), content)
            continue
        body, headers = mutated(rng, TABLE.encode()), {}
        if rng.random() < 0.3:
            body, headers = mutated(rng, gzip.compress(body)), {"Content-Encoding": "gzip"}
        status, _, content = service.ask("/localize", body, headers)
        note(said[LOGS], str(status), content)


def note_message(said: Counter, content: str | bytes) -> None:
    """Count an answer of a WebSocket."""
    answer = json.loads(content)
    note(said, str(answer["status"]) if answer["type"] == "error" else f"a {answer['type']}", content)


def note(said: Counter, answer: str, content: str | bytes) -> None:
    """Count an answer, and what it should not say."""
    words = content.decode(errors="replace") if isinstance(content, bytes) else content
    said[answer] += 1
    if '"schema"' not in words and any(leak in words for leak in LEAKS):
        said[f"{TOO_MUCH}: {words[:200]}"] += 1


if __name__ == "__main__":
    main()
