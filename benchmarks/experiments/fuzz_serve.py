# SPDX-License-Identifier: BSD-3-Clause
"""Mutated bodies, paths and frames against a service: which statuses they get, and whether any says too much.

Counted are answers by status, those of 500, words of this machine (paths, tracebacks) in what is said, and processes
that had to be started again. The same seed sends the same.

Run: PYTHONPATH=tests python benchmarks/experiments/fuzz_serve.py MAP [--n N] [--seed S]
"""

import gzip
import json
import random
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from magmatch_evaluation.script import arguments
from serving import Service, serving

LEAKS = ("Traceback", "/tmp/", "/root", "/home", ".py", "site-packages", 'File "')
ROW = "{},{},0,0,2e-5,0,-4e-5,0,0,0,1\n"
TABLE = "t,x,y,z,bx,by,bz,qx,qy,qz,qw\n" + "".join(ROW.format(k, k / 10) for k in range(40))
SAMPLE = {"t": 1.0, "position": [0, 0, 0], "orientation": [0, 0, 0, 1], "field": [2e-5, 0, 4e-5]}
HELLO = json.dumps({"type": "hello"})
PATHS = ("/maps/{}", "/{}", "/localize?{}=1", "/register?seed={}", "/maps/{}/..")
SETTINGS = "max_requests: 10000000\nmax_connects: 10000000\nmax_mistakes: 1000\npatience: 5\nmax_work_time: 20\n"


def main() -> None:
    asked = arguments(__doc__, (), n=10_000, seed=0)
    rng, said = random.Random(asked.seed), Counter()
    with TemporaryDirectory() as folder:
        settings = Path(folder) / "settings.yaml"
        settings.write_text(SETTINGS)
        with serving(asked.words[0], "--config", settings, "--states", Path(folder) / "states") as service:
            fuzz_frames(service, rng, asked.n * 6 // 10, said)
            fuzz_hellos(service, rng, asked.n // 10, said)
            fuzz_requests(service, rng, asked.n - asked.n * 7 // 10, said)
            metrics = service.ask("/metrics")[2].decode()
            words = service.words()
        restarts = next(line for line in metrics.splitlines() if line.startswith("magmatch_tracker_restarts"))
    for key, n in sorted(said.items()):
        print(f"{n:7d}  {key}")
    print(restarts)
    print(f"{words.count('Traceback')} tracebacks in the service's own log")


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


def fuzz_frames(service: Service, rng: random.Random, n: int, said: Counter) -> None:
    """Messages after a good hello."""
    wire = None
    for _ in range(n):
        try:
            if wire is None:
                wire = connect(service.live, proxy=None)
                wire.send(HELLO)
                wire.recv(timeout=60)
            message = mutated(rng, json.dumps(SAMPLE).encode())
            wire.send(message.decode(errors="replace") if rng.random() < 0.7 else message)
            note(said, "frame", wire.recv(timeout=60))
        except WebSocketException as error:
            note(said, "frame closed", str(error))
            wire = None
    if wire is not None:
        wire.close()


def fuzz_hellos(service: Service, rng: random.Random, n: int, said: Counter) -> None:
    """First messages."""
    for _ in range(n):
        try:
            with connect(service.live, proxy=None) as wire:
                wire.send(mutated(rng, HELLO.encode()).decode(errors="replace"))
                note(said, "hello", wire.recv(timeout=60))
        except WebSocketException as error:
            note(said, "hello closed", str(error))


def fuzz_requests(service: Service, rng: random.Random, n: int, said: Counter) -> None:
    """Paths, words of queries, and bodies."""
    for _ in range(n):
        if rng.random() < 0.4:
            word = "".join(rng.choice("abc%./~?&=;0129") for _ in range(rng.randrange(30)))
            status, _, content = service.ask(rng.choice(PATHS).format(word), rng.choice([None, b"x"]))
            note(said, f"path {status}", content)
            continue
        body, headers = mutated(rng, TABLE.encode()), {}
        if rng.random() < 0.3:
            body, headers = mutated(rng, gzip.compress(body)), {"Content-Encoding": "gzip"}
        status, _, content = service.ask("/localize", body, headers)
        note(said, f"body {status}", content)


def note(said: Counter, kind: str, content: str | bytes) -> None:
    """Count an answer, and what it should not say."""
    words = content.decode(errors="replace") if isinstance(content, bytes) else content
    if kind in {"frame", "hello"}:
        answer = json.loads(words)
        kind += f" {answer.get('status') if answer['type'] == 'error' else answer['type']}"
    said[kind] += 1
    if '"schema"' not in words and any(leak in words for leak in LEAKS):
        said[f"says too much: {words[:200]}"] += 1


if __name__ == "__main__":
    main()
