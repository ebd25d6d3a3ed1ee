# SPDX-License-Identifier: BSD-3-Clause
"""A small surveyed place, and the program run in this process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from drifting import give_numbers
from magmatch.cli.main import main
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate, write_pair


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the program; gives exit code, stdout and stderr."""

    def call(*words: object) -> Outcome:
        capfd.readouterr()
        code = main([str(word) for word in words])
        captured = capfd.readouterr()
        return Outcome(code, captured.out, captured.err)

    return call


@pytest.fixture
def refused(run: Run) -> Callable[..., str]:
    """Run the program on what it refuses: code 2, one line with some words, a folder left empty; gives the line."""

    def call(words: Sequence[object], said: str, left_empty: Path | None = None) -> str:
        outcome = run(*words)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome
        assert outcome.err.startswith("magmatch: ")
        assert said in outcome.err
        assert left_empty is None or not list(left_empty.iterdir())
        return outcome.err

    return call


@pytest.fixture
def numbers_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map of a session is made at once: its numbers are given, not chosen."""
    give_numbers(monkeypatch)


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with base.csv, target.csv, truth.json, base.map, target.map, result.json and report.html."""
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    folder = tmp_path_factory.mktemp("place")
    write_pair(simulate("office", 1, SimulationConfig(n_samples=300, room_size=(2.0, 2.0, 0.8))), folder)
    for name in ("base", "target"):
        assert (
            main(["map", str(folder / f"{name}.csv"), "--prior", "spline", "--out", str(folder / f"{name}.map")]) == 0
        )
    words = ["register", folder / "base.map", folder / "target.map", "--out", folder / "result.json"]
    assert main([str(word) for word in [*words, "--report", folder / "report.html"]]) == 0
    return folder
