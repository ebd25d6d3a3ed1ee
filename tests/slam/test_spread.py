# SPDX-License-Identifier: BSD-3-Clause
"""Stretches mapped and windows compared by workers: what is found is the same, to the bit."""

import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest

from magmatch.geometry import product, random_transform
from magmatch.slam import steps
from magmatch.slam.run import slam
from magmatch.slam.search import bases
from magmatch.slam.search.bases import TOGETHER, base_of
from magmatch.slam.search.candidates import N_NUMBERS
from magmatch.slam.search.comparison import Comparison
from magmatch.slam.search.predicted import nearby
from magmatch.workers import DaskRunner, bit_for_bit


def assert_same(session, other):
    for one, two in zip(
        (session.graph, session.trajectories[-1]), (other.graph, other.trajectories[-1]), strict=True
    ):
        for name in ("p", "R", "positions", "field"):
            if hasattr(one, name):
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    pairs = zip(session.graph.closures, other.graph.closures, strict=True)
    assert all((c.first, c.second, c.weight) == (d.first, d.second, d.weight) for c, d in pairs)


def test_what_is_sent_away_and_comes_back_gives_the_same_session(three):
    """Whole logs are compared too, as long as nothing ties them."""
    assert_same(slam(three.logs, run=map), three.session)


def test_worker_processes_give_the_same_session(lone):
    pytest.importorskip("distributed")
    with DaskRunner(jobs=2, ahead=2) as run:
        assert_same(slam(lone.log, run=run), lone.session)


def test_rigid_transforms_are_sent_as_they_are():
    rng = np.random.default_rng(0)
    sent = [product(random_transform(rng), random_transform(rng)) for _ in range(200)]
    named = [_Named(T) for T in sent]
    back = list(bit_for_bit(map)(_inverse, named))
    assert all((T.inv().as_matrix() == U.as_matrix()).all() for T, U in zip(sent, back, strict=True))
    # What SciPy makes of them.
    assert not all((pickle.loads(pickle.dumps(T)).as_matrix() == T.as_matrix()).all() for T in sent)


class _Named:
    name, home = "a transform", None

    def __init__(self, T):
        self.T = T


def _inverse(one):
    return one.T.inv()


def test_a_worker_makes_each_base_once(lone, monkeypatch):
    places = lone.session.places.copied()
    maker, path = places.maker, places.paths[0]
    made, make = [], bases.make_base
    monkeypatch.setattr(bases, "_kept", {})
    monkeypatch.setattr(bases, "make_base", lambda task: made.append(task) or make(task))
    tasks = [maker.task(path, node) for node in (0, 1, TOGETHER)]
    assert tasks[0] is tasks[1]
    noisier = replace(maker.noise, misfit_sd=2 * maker.noise.misfit_sd)
    found = [base_of(pickle.loads(pickle.dumps(task)), noise) for task in tasks for noise in (maker.noise, noisier)]
    assert len(made) == 2
    assert [base.index.noise for base in found] == 3 * [maker.noise, noisier]


def test_a_stretch_has_one_home_and_a_whole_log_has_all(lone):
    places = lone.session.places
    path, maker = places.paths[0], places.maker
    homes = [maker.task(path, node).home for node in path.nodes.tolist()]
    assert homes == [node // TOGETHER for node in path.nodes.tolist()]
    whole = [Comparison(w, maker.task(path, 0), 100.0, maker.noise).home for w in path.windows]
    assert len(set(whole)) == len(whole)


def test_what_is_read_back_still_tells_when_a_stretch_was_first_asked_for(lone):
    """The noise that was known then tells which pairs of points are listed."""
    places = lone.session.places.copied()
    window, nodes = places.paths[0].windows[-1], np.arange(4)
    asked = places.stretches(nearby(window, nodes, places.graph), window)
    places.maker._tasks, places.steps = {}, lambda _: np.zeros((0, N_NUMBERS))
    assert asked
    places.at([window], [nodes])
    assert places.maker._tasks.keys() == asked.keys()
    assert not places.maker._made.keys() & asked.keys()


@pytest.mark.parametrize("run", [None, map])
def test_a_search_that_was_interrupted_ends_as_if_it_was_not(lone, tmp_path, monkeypatch, run):
    """In the middle of the windows that are looked for together, before and after the noise was learned."""
    monkeypatch.setattr(steps, "KEEP_EVERY_S", 0.0)
    slam(lone.log, keep=tmp_path / "all")
    kept = sorted((tmp_path / "all").iterdir(), key=lambda path: int(path.stem))
    for share in (0.3, 0.7):
        part = tmp_path / f"{share}"
        part.mkdir()
        for path in kept[: int(share * len(kept))]:
            shutil.copy(path, part)
        assert_same(slam(lone.log, run=run, keep=part), lone.session)


def test_few_stretches_are_kept_and_all_that_are_asked_for_are_given(lone, monkeypatch):
    monkeypatch.setattr(bases, "MOST_BASES", 2)
    places = lone.session.places.copied()
    path = places.paths[0]
    nodes = path.nodes[: 3 * TOGETHER].tolist()
    given = places.maker.given([(path, node) for node in nodes])
    assert len({id(base) for base in given}) == 3
    assert all(node in base.node for node, base in zip(nodes, given, strict=True))
    assert places.stretch(0) is given[0]
    assert {id(base) for base in places.maker._made.values()} <= {id(base) for base in given}
