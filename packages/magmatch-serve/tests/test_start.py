# SPDX-License-Identifier: BSD-3-Clause
"""A service that cannot start says why in one line; one that is told to end leaves as other commands do."""

import socket

import pytest

from magmatch.cli.main import main
from magmatch_serve.bodies import checkpoints
from serving import serving


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


def test_what_keeps_it_from_starting_is_one_line(fault, tmp_path, monkeypatch, capfd):
    place, options, words = fault
    if "--host" in options:
        options = [*options, "--token-file", place.with_name("token.txt")]
        options[-1].write_text("a-token-of-enough-letters")
    monkeypatch.setattr("signal.signal", lambda *_: None)  # this process goes on
    code = main(["serve", str(place), "--port", "0", *map(str, options)])
    err = capfd.readouterr().err
    said = [line for line in err.splitlines() if not line.startswith("Loading")]
    assert (code, len(said)) == (2, 1), err
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
