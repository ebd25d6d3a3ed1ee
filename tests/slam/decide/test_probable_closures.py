# SPDX-License-Identifier: BSD-3-Clause
"""A window that fits at several poses about one place gives one closure, as uncertain as they differ."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.slam.decide import Weighted, by_pass, closure_beside, same_answer
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.search.loop_closure import Match

HERE = RigidTransform.identity()


def pose(x, y=0.0, turn=0.0):
    return RigidTransform.from_components([x, y, 0.0], Rotation.from_rotvec([0, 0, turn]))


def candidate(node, T, C, log_odds=3.0):
    return Candidate(node, T, Match(HERE, C, log_odds, -2.0, HERE, C))


def test_poses_within_a_field_length_are_one_answer_and_those_beyond_or_turned_are_not(lone):
    window = lone.session.paths[0].windows[5]
    one, turn = window.length, 2 * window.length / window.path_length
    poses = [pose(0.0), pose(0.9 * one), pose(1.1 * one), pose(0.0, turn=0.9 * turn), pose(0.0, turn=1.1 * turn)]
    assert same_answer(poses, np.array([0.4, 0.3, 0.1, 0.15, 0.05]), window).tolist() == [0, 1, 3]
    assert not len(same_answer([], np.zeros(0), window))


def test_the_closure_has_mean_and_covariance_of_all_that_may_be(lone):
    graph, path = lone.session.graph, lone.session.paths[0]
    rng = np.random.default_rng(0)
    near, far = np.diag([0.01, 0.01, 0.03, 0.05, 0.1, 0.02]) ** 2, np.diag([0.01, 0.01, 0.05, 0.2, 0.1, 0.02]) ** 2
    first, last = path.nodes[2], path.nodes[-3]
    # The second lies beside the next node of the same pass.
    step = graph.center(first).inv() * graph.center(first + 1)
    some = [candidate(first, pose(0.1, 0.2), near), candidate(first + 1, step.inv() * pose(0.6, 0.1, 0.1), far)]
    closure = closure_beside([Weighted(some[0], 0.6), Weighted(some[1], 0.2)], last, [path], 2.0, graph)
    alone = closure_beside([Weighted(some[0], 0.6)], last, [path], 2.0, graph)
    np.testing.assert_allclose(alone.T_first_second.as_matrix(), pose(0.1, 0.2).as_matrix(), atol=1e-12)
    # Drawn: three of four from the first.
    n, base = 40_000, alone.T_first_second
    draws = []
    for T, C, share in ((pose(0.1, 0.2), near, 0.75), (pose(0.6, 0.1, 0.1), far, 0.25)):
        xi = rng.standard_normal((int(share * n), 6)) * np.sqrt(np.diag(C))
        off = base.inv() * T * RigidTransform.from_components(xi[:, 3:], Rotation.from_rotvec(xi[:, :3]))
        draws.append(np.hstack([off.rotation.as_rotvec(), off.translation]))
    drawn = np.vstack(draws)
    off = base.inv() * closure.T_first_second
    found = np.concatenate([off.rotation.as_rotvec(), off.translation])
    np.testing.assert_allclose(found, drawn.mean(axis=0), atol=0.01)
    added = closure.covariance - alone.covariance
    np.testing.assert_allclose(np.diag(added), np.diag(np.cov(drawn.T)) - np.diag(near), atol=5e-3)


@pytest.mark.parametrize(("log_odds", "passes"), [(1.0, 2), (-1.0, 1)])
def test_another_pass_closes_too_unless_it_speaks_against_the_place(three, log_odds, passes):
    graph, (a, b, _) = three.session.graph, three.session.places.paths
    C = np.eye(6)
    some = [candidate(a.first_node, HERE, C), candidate(a.first_node + 1, HERE, C)]
    some.append(replace(candidate(b.first_node, HERE, C, log_odds)))
    groups = by_pass(some, np.array([0.5, 0.3, 0.2]), graph)
    assert [[one.probability for one in group] for group in groups] == [[0.5, 0.3], [0.2]][:passes]
