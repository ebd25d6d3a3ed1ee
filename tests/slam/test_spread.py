# SPDX-License-Identifier: BSD-3-Clause
"""Stretches mapped and windows compared by workers: what is found is the same, to the bit."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from magmatch.geometry import product, random_transform
from magmatch.slam import bases
from magmatch.slam.bases import TOGETHER, base_of
from magmatch.slam.comparison import Comparison
from magmatch.slam.run import slam
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
    name = "a transform"

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
