# SPDX-License-Identifier: BSD-3-Clause
"""A closure is doubted for what the graph has learned since it was found."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import expit

from magmatch.slam.graph import solve as solving
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.solve import solve, surprise_before, surprises
from slam.graph.test_pose_graph import LEVEL, TIGHT, between, graph_of, ring

TRUE = ring(24, laps=2)


def drifted(off, looseness):
    """Two laps whose odometry has drifted off at their end."""
    graph = graph_of(TRUE + np.linspace(0, 1, 24)[:, None] * [off, 0, 0], LEVEL, looseness=looseness)
    solve(graph)
    return graph


@pytest.mark.parametrize("looseness", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("off", [0.2, 0.5, 0.8])
def test_a_lone_closure_is_as_probable_as_its_odds_however_far_odometry_has_drifted(off, looseness):
    graph = drifted(off, looseness)
    closure = between(TRUE, 2, 20, log_odds=1.7)
    graph.closures = [replace(closure, paid=surprise_before(graph, closure))]
    solve(graph)
    assert graph.closures[0].weight == pytest.approx(expit(1.7), abs=0.01)


def test_one_that_fits_nowhere_however_far_odometry_bends_is_rejected():
    graph = drifted(0.8, 0.03)
    closure = between(TRUE, 2, 20, log_odds=1.7)
    graph.closures = [replace(closure, paid=surprise_before(graph, closure))]
    solve(graph)
    assert not graph.closures[0].is_kept


def test_it_is_rejected_once_others_say_that_it_is_wrong():
    graph = drifted(0.5, 0.3)
    wrong = between(TRUE, 3, 15, error=(0.6, -0.4, 0.0), log_odds=4.0)
    wrong = replace(wrong, paid=surprise_before(graph, wrong))
    graph.closures = [wrong]
    solve(graph)
    assert graph.closures[0].is_kept
    graph.closures = [*graph.closures, *(between(TRUE, k, k + 12) for k in (1, 2, 4, 5))]
    solve(graph)
    assert [c.is_kept for c in graph.closures] == [False, True, True, True, True]


@pytest.mark.parametrize("weight", [0.02, 0.3, 0.9, 1.0])
@pytest.mark.parametrize("others", [0, 3])
def test_how_the_rest_of_the_graph_sees_a_closure_is_how_the_graph_without_it_does(monkeypatch, weight, others):
    monkeypatch.setattr(solving, "probabilities", lambda graph, at_first: graph.as_arrays.weight)
    rest = [between(TRUE, k, 12 + k, (0, 0.02, 0)) for k in range(5, 5 + 2 * others, 2)]
    closure = replace(between(TRUE, 4, 18), weight=weight)
    seen = []
    for closures in (rest, [closure, *rest]):
        graph = drifted(0.3, 0.05)
        graph.closures = closures
        for _ in range(2):  # factors are of where a solution began
            solve(graph)
        seen.append(surprises(graph)[0][0] if closure in closures else surprise_before(graph, closure))
    assert seen[1] == pytest.approx(seen[0], rel=0.03)


def test_a_closure_between_logs_that_nothing_else_connects_surprises_nobody():
    graph = graph_of(TRUE, LEVEL, logs=np.repeat([0, 1], 12))
    closure = between(TRUE + np.array([3.0, 0.0, 0.0]), 2, 14)
    assert surprise_before(graph, closure) == 0.0
    graph.closures = [closure]
    for _ in range(2):
        solve(graph)
    assert max(surprises(graph)[0]) < 0.1


@pytest.mark.parametrize("is_inverse", [False, True], ids=["base first", "base second"])
@pytest.mark.parametrize("degrees", [30, 120, 180])
def test_logs_that_closures_connect_are_brought_together_however_their_frames_are_turned(degrees, is_inverse):
    turn = Rotation.from_euler("z", degrees, degrees=True)
    walked = np.vstack([TRUE[:12], turn.inv().apply(TRUE[12:] - [3.0, 1.0, 0.0])])
    graph = graph_of(walked, LEVEL, logs=np.repeat([0, 1], 12), looseness=0.3)
    # About half a turn, errors of headings have it one way round or the other.
    for k, error in enumerate([0.04, -0.04, 0.03, -0.03, 0.02, -0.02]):
        heading = turn * Rotation.from_rotvec([0.0, 0.0, error])
        T = RigidTransform.from_components(TRUE[12 + 2 * k] - TRUE[2 * k], heading)
        ends = (12 + 2 * k, 2 * k, T.inv()) if is_inverse else (2 * k, 12 + 2 * k, T)
        graph.closures = [*graph.closures, Closure(*ends, TIGHT, 10.0)]
    solve(graph)
    assert all(c.is_kept for c in graph.closures)
    np.testing.assert_allclose(graph.p, TRUE, atol=0.3)
    np.testing.assert_allclose(graph.R[12:], np.broadcast_to(turn.as_matrix(), (12, 3, 3)), atol=0.1)
