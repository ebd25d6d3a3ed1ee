# SPDX-License-Identifier: BSD-3-Clause
"""Submaps made and windows compared by workers: what is found is the same, to the bit."""

import shutil

import numpy as np
import pytest

from drifting import Place, drifting_walk
from magmatch import runner
from magmatch.slam.run import slam
from other_process import elsewhere


def assert_same(session, other):
    for one, two in zip(
        (session.graph, session.trajectories[-1]), (other.graph, other.trajectories[-1]), strict=True
    ):
        for name in ("p", "R", "positions", "field"):
            if hasattr(one, name):
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    pairs = zip(session.graph.closures, other.graph.closures, strict=True)
    assert all((c.first, c.second, c.weight) == (d.first, d.second, d.weight) for c, d in pairs)


def test_what_is_sent_away_and_comes_back_gives_the_same_session():
    """Whole logs are compared too, as long as nothing ties them."""
    logs = [drifting_walk(Place(1), k, laps=0.8, start=0.5 * k, name=f"{k}.csv")[0] for k in (1, 2)]
    here = slam(logs)
    assert here.components == [[0, 1]]
    assert_same(slam(logs, run=elsewhere), here)


@pytest.fixture(scope="module")
def kept(lone, tmp_path_factory):
    """A folder in which all that was found for the log was kept as soon as it was found."""
    folder = tmp_path_factory.mktemp("spread") / "kept"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "KEEP_EVERY_S", 0.0)
        slam(lone.log, keep=folder)
    return folder


def test_what_was_kept_needs_no_submap(lone, kept, monkeypatch):
    monkeypatch.setattr(runner.Shelf, "take", None)
    assert_same(slam(lone.log, keep=kept), lone.session)


@pytest.mark.parametrize("run", [None, pytest.param(elsewhere, marks=pytest.mark.slow)])
def test_a_search_that_was_interrupted_ends_as_if_it_was_not(lone, kept, tmp_path, monkeypatch, run):
    """In the middle of the windows that are looked for together, before and after the noise was learned."""
    monkeypatch.setattr(runner, "KEEP_EVERY_S", 0.0)
    files = sorted(kept.iterdir(), key=lambda path: int(path.stem))
    for share in (0.3, 0.7):
        part = tmp_path / f"{share}"
        part.mkdir()
        for path in files[: int(share * len(files))]:
            shutil.copy(path, part)
        assert_same(slam(lone.log, run=run, keep=part), lone.session)
