# SPDX-License-Identifier: BSD-3-Clause
"""A service that cannot start says why in one line; one that is told to end leaves as other commands do."""

import os
import socket
import subprocess
import sys

import pytest

from magmatch_serve.bodies import checkpoints
from serving import serving


def start(place, *options):
    words = [sys.executable, "-m", "magmatch", "serve", str(place), "--port", "0", *map(str, options)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=180, env=environment)


@pytest.fixture(
    params=["no map", "half a map", "a folder without maps", "an address", "Foxglove's port", "states in use"]
)
def fault(request, hall, tmp_path):
    """What is served, with which options, and what is said of it."""
    log, half, empty, states = (tmp_path / name for name in ("walk.csv", "half.map", "empty", "states"))
    log.write_text("t,x\n1,2\n")
    half.write_bytes(hall.map.read_bytes()[:-2000])
    empty.mkdir()
    with checkpoints.held(states), socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        yield {
            "no map": (log, [], "expected a saved map"),
            "half a map": (half, [], str(half)),
            "a folder without maps": (empty, [], "map"),
            "an address": (hall.map, ["--host", "203.0.113.1"], "say --host or --port"),
            "Foxglove's port": (hall.map, ["--foxglove", port, "--states", empty], "--foxglove"),
            "states in use": (hall.map, ["--states", states], "another service"),
        }[request.param]


def test_what_keeps_it_from_starting_is_one_line(fault, tmp_path):
    place, options, words = fault
    if "--host" in options:
        options = [*options, "--token-file", place.with_name("token.txt")]
        options[-1].write_text("a-token-of-enough-letters")
    done = start(place, *options)
    said = [line for line in done.stderr.splitlines() if not line.startswith("Loading")]
    assert (done.returncode, len(said)) == (2, 1), done.stderr
    assert words in said[0]
    # Nothing was begun beside what is no map.
    assert place.name == "hall.map" or not [*tmp_path.rglob("*.clients"), *tmp_path.rglob(".clients")]


@pytest.mark.slow
def test_a_service_that_is_stopped_leaves_without_a_word(hall, tmp_path):
    with serving(hall.map, "--states", tmp_path / "states") as service:
        assert service.ask("/localize", b"no log")[0] == 422  # a process works on logs now
        before = service.words()
        assert service.end() == before
    assert service.process.returncode == 0
