# SPDX-License-Identifier: BSD-3-Clause
"""Poses of windows near where the graph expects them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import multivariate_normal

from drifting import submap_at
from magmatch.geometry import turn_and_shift
from magmatch.preparation.odometry.drift import LEVEL_SD, UPRIGHT_SD
from magmatch.registration.search.candidate import SearchResult
from magmatch.slam.config import SlamConfig
from magmatch.slam.search import loop_closure
from magmatch.slam.search.loop_closure import NODE_COVARIANCE, Anywhere, Rough, compare, log_density, matches
from magmatch.slam.search.searched import Searched


def test_where_the_search_finds_nothing_the_graph_s_expectation_is_a_pose_to_begin_from(near, monkeypatch):
    monkeypatch.setattr(loop_closure, "pair_search", lambda *_: SearchResult())
    (found, *_), at = matches(near.window, near.base, near.rough), near.window.center
    assert np.linalg.norm(found.T_base_log.apply(at) - near.rough.T_base_log.apply(at)) < 0.1
    assert found.log_odds > 0
    assert not matches(near.window, near.base, Anywhere(100.0))


def test_what_the_field_says_of_a_pose_is_apart_from_what_its_prediction_costs(near):
    """A neighbour that predicts the pose replaces the prior, and is paid what the prior took.

    The law of evidence saturates, and the prior does not: strong evidence makes no unlikely pose cheap.
    """
    node, drifts = near.window.T_log_node, near.window.config.drifts
    (match, *_) = matches(near.window, near.base, near.rough)
    pose_of = match.T_base_log * node
    C = (near.rough.covariance + NODE_COVARIANCE)[np.ix_(drifts, drifts)]

    def expected_off(sds):
        """The same pose, which is expected so many standard deviations away; and the density of that."""
        sd = np.sqrt(np.diag(near.rough.covariance))
        off = pose([0, 0, sds * sd[2]], [sds * sd[3], 0, 0])
        rough = Rough(pose_of * off * node.inv(), near.rough.covariance)
        found = matches(near.window, near.base, rough, [match.T_base_log])
        m = min(found, key=lambda m: np.linalg.norm((pose_of.inv() * m.T_base_log * node).translation))
        assert np.linalg.norm((pose_of.inv() * m.T_base_log * node).translation) < 0.1
        xi = turn_and_shift(off.inv() * pose_of.inv() * m.T_base_log * node)
        return m, multivariate_normal.logpdf(xi[drifts], cov=C)

    there, _ = expected_off(0.0)
    for sds in (1.0, 2.0, 3.0):
        m, density = expected_off(sds)
        assert m.log_prior == pytest.approx(density, abs=1e-6)
        assert m.log_odds - m.log_prior == pytest.approx(there.log_odds - there.log_prior, abs=0.5)
    assert there.log_prior - m.log_prior > 4


def test_the_prior_that_neighbours_replace_is_of_what_drifts_alone(near):
    """Else a pose that leans against gravity would be as likely as a neighbour predicts its place."""
    drifts = near.window.config.drifts
    C = near.rough.covariance + NODE_COVARIANCE
    densest = multivariate_normal.logpdf(np.zeros(len(drifts)), cov=C[np.ix_(drifts, drifts)])
    for lean in (0.0, 0.1):
        off = near.window.T_log_node * pose([lean, 0, 0], [0, 0, 0.3 * lean]) * near.window.T_log_node.inv()
        (match, *_) = matches(near.window, near.base, Rough(near.rough.T_base_log * off, near.rough.covariance))
        assert densest - 0.3 < match.log_prior <= densest


def test_a_closure_knows_height_and_lean_no_better_than_its_two_nodes_hold_them(lone):
    """Odometry that rises by centimetres would be contradicted by every closure, if the field shows millimetres."""
    graph = lone.session._now.graph
    assert graph.config.is_planar
    for closure in graph.closures:
        lean, height = closure.covariance[:2, :2], closure.covariance[5, 5]
        assert np.linalg.eigvalsh(lean)[0] >= 2 * UPRIGHT_SD**2
        assert height >= 2 * LEVEL_SD**2


@pytest.fixture
def near(lone):
    """A window that closes, its base, and where the graph would expect it, roughly."""
    places = lone.session._now
    closure = max(places.graph.closures, key=lambda c: c.log_odds)
    window = places.paths[0].windows[closure.second]
    T = places.graph.center(closure.first) * closure.T_first_second * window.T_log_node.inv()
    rough = Rough(T, np.diag([0.01, 0.01, 0.1, 0.2, 0.2, 0.05]) ** 2)
    return SimpleNamespace(window=window, base=submap_at(places, closure.first), rough=rough, node=closure.first)


def test_poses_that_are_no_longer_expected_are_not_weighed(near):
    known = [m.T_base_log for m in matches(near.window, near.base, near.rough)]
    node = near.window.T_log_node
    far = node * RigidTransform.from_translation([4.0, 0, 0]) * node.inv()
    elsewhere = Rough(near.rough.T_base_log * far, near.rough.covariance)
    assert not matches(near.window, near.base, elsewhere, known[:1], np.array([near.node]))
    assert matches(near.window, near.base, near.rough, known[:1], np.array([near.node]))
    assert not matches(near.window, near.base, near.rough, known[:1], np.array([10_000]))


def test_what_the_graph_predicts_is_not_in_what_the_field_alone_says(near):
    """Else the graph would hear its own prediction again as a measurement, and be surer with each closure."""
    drifts = near.window.config.drifts
    node = near.window.T_log_node

    def alone(sd, off):
        C = near.rough.covariance.copy()
        C[drifts, drifts] = sd**2
        T = near.rough.T_base_log * node * RigidTransform.from_translation([off, -off, 0]) * node.inv()
        (m, *_) = matches(near.window, near.base, Rough(T, C))
        return m.T_base_log, m.T_base_log * node * m.T_node_alone, m.covariance_alone[np.ix_(drifts, drifts)]

    T, wide, C = alone(0.3, 0.0)
    T_pulled, tight, D = alone(0.03, 0.1)
    sd = np.sqrt(np.diag(C))
    pulled, left = (
        np.concatenate([d.rotation.as_rotvec(), d.translation])[drifts] / sd
        for d in ((T * node).inv() * T_pulled * node, wide.inv() * tight)
    )
    assert np.abs(pulled).max() > 0.5
    assert np.abs(left).max() < 0.3
    np.testing.assert_allclose(np.linalg.solve(C, D), np.eye(len(drifts)), atol=0.4)


def test_a_pose_that_the_graph_knows_well_is_refined_without_a_search(lone, near, monkeypatch):
    places = lone.session._now
    sure = Rough(near.rough.T_base_log, near.rough.covariance * 0.3**2)
    assert sure.is_narrow(near.window.length)
    assert not near.rough.is_narrow(near.window.length)

    def look(rough):
        return compare(near.window, near.base, rough, places.maker.noise, nodes=np.array([near.node]))

    searched = look(near.rough)
    monkeypatch.setattr(loop_closure, "pair_search", None)
    ((node, found),) = look(sure)
    assert node == near.node
    poses = [match.T_base_log.apply(near.window.center) for match in (found, *(match for _, match in searched))]
    assert np.linalg.norm(poses[0] - poses[1:], axis=1).min() < 0.05
    # What lies beside other nodes is refined by their stretch.
    ahead = RigidTransform.from_translation([2 * near.window.path_length, 0.0, 0.0])
    assert not look(Rough(ahead * sure.T_base_log, sure.covariance))


@pytest.mark.parametrize(
    ("moved", "turned", "wider", "holds", "stands"),
    [
        (0.0, 0.0, 1.0, True, True),
        (0.2, 0.0, 1.0, True, True),
        (0.0, 0.0, 1.1, True, True),
        (0.0, 0.0, 4.0, False, False),
        (0.0, 0.0, 0.25, True, False),
        (3.5, 0.0, 0.25, False, False),
        (0.0, 0.4, 0.25, False, False),
    ],
)
def test_what_was_searched_holds_what_is_expected_there_and_stands_if_expected_as_it_was(
    near, moved, turned, wider, holds, stands
):
    T, C, node = near.rough.T_base_log, near.rough.covariance, near.window.T_log_node
    searched = Searched(np.array([near.node]), near.rough, near.rough, [])
    now = Rough(T * node * pose([0, 0, turned], [moved * np.sqrt(C[3, 3]), 0, 0]) * node.inv(), wider * C)
    assert searched.holds(now, searched.nodes, near.window) == holds
    assert searched.stands(now, near.window) == stands
    assert not searched.holds(now, np.array([near.node, near.node + 1]), near.window)
    assert not replace(searched, weighed=None).stands(now, near.window)


FREE, ALIGNED, PLANAR = (
    SlamConfig(is_gravity_aligned=aligned, is_planar=planar)
    for aligned, planar in ((False, False), (True, False), (True, True))
)
C = np.diag([0.01, 0.01, 0.2, 0.5, 0.7, 0.05]) ** 2


def pose(rotvec, shift):
    return RigidTransform.from_components(np.array(shift), Rotation.from_rotvec(rotvec))


@pytest.mark.parametrize(("config", "drifts"), [(FREE, range(6)), (ALIGNED, range(2, 6)), (PLANAR, range(2, 5))])
def test_predictions_are_normal_densities_of_the_components_that_drift(config, drifts):
    rng, rows = np.random.default_rng(0), list(drifts)
    xi, many = 0.3 * rng.standard_normal((5, 6)), C * rng.uniform(0.5, 2.0, (5, 1, 1))
    offs = [pose(one[:3], one[3:]) for one in xi]
    expected = [multivariate_normal.logpdf(x[rows], cov=S[np.ix_(rows, rows)]) for x, S in zip(xi, many, strict=True)]
    np.testing.assert_allclose(log_density(RigidTransform.concatenate(offs), many, config.drifts), expected)
    assert log_density(offs[0], many[0], config.drifts) == pytest.approx(expected[0])
