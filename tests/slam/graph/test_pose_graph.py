# SPDX-License-Identifier: BSD-3-Clause
"""The graph: slopes, covariances, known loops found again, and closures that the rest contradicts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import adjoint
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import Closure, Edges, FixedPoints, SubmapFactor
from magmatch.slam.graph.normal_equations import counted, normal_equations
from magmatch.slam.graph.pose_graph import SURE, PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.windows import lasting_errors

LEVEL = SlamConfig(is_planar=True)
FREE = SlamConfig(is_gravity_aligned=False)
# A closure's own error: rad, m.
TIGHT = np.diag([1e-3] * 3 + [0.02] * 3) ** 2


def ring(n, laps=2, radius=5.0):
    """Nodes on some laps of a circle, whose axes stay the odometry's."""
    s = np.linspace(0, 2 * np.pi * laps, n, endpoint=False)
    return radius * np.column_stack([np.cos(s), np.sin(s), 0 * s])


def graph_of(walked, config=LEVEL, logs=None, looseness=1.0):
    """A graph whose odometry says what it is given, and wanders by so much besides what lasts."""
    logs = np.zeros(len(walked), np.int64) if logs is None else np.asarray(logs)
    first = np.flatnonzero(logs[1:] == logs[:-1])
    shift = walked[first + 1] - walked[first]
    covariance = np.tile((looseness * np.diag([0.01, 0.01, 0.05, 0.1, 0.1, 0.1])) ** 2, (len(first), 1, 1))
    lasting = np.array([lasting_errors(walked[[k, k + 1]], 0, upright=True)[-1] for k in first]).reshape(-1, 6, 2)
    edges = Edges(first, first + 1, shift, covariance, lasting, logs[first])
    return PoseGraph(config, np.tile(np.eye(3), (len(walked), 1, 1)), walked.copy(), logs, edges)


def between(true, i, j, error=(0.0, 0.0, 0.0), log_odds=10.0):
    T = RigidTransform.from_translation(true[j] - true[i] + error)
    return Closure(i, j, T, TIGHT, log_odds)


def wandered(graph, rng, size=0.3):
    """Nodes anywhere: slopes must hold there too."""
    n = len(graph.p)
    graph.p = graph.p + size * rng.normal(size=(n, 3))
    graph.R = Rotation.from_rotvec(size * rng.normal(size=(n, 3))).as_matrix()
    return graph


@pytest.mark.parametrize("config", [LEVEL, FREE], ids=["level", "free"])
def test_the_gradient_of_half_chi2_is_that_of_finite_differences(config):
    rng, small = np.random.default_rng(1), 1e-6

    def graph(xi=None, lasting=None):
        one = wandered(graph_of(ring(6), config, logs=[0, 0, 0, 1, 1, 1]), np.random.default_rng(2), size=0.02)
        one.closures = [between(ring(6), 0, 4), between(ring(6), 1, 2, error=(0.1, 0.0, 0.0))]
        one.submap_factors = (on_map(ring(6), 5, [0, 3], [0.3, 0.7], error=(0.0, 0.1, 0.05)),)
        one.lasting = np.array([[0.1, 0.01], [-0.2, -0.01]])
        at, sd = ring(6)[[1, 4]] + 0.3, np.array([0.1, 0.2])
        one.fixed = FixedPoints(np.array([1, 3]), np.array([2, 4]), np.array([0.3, 0.6]), at, at + 0.1, sd)
        if xi is not None:
            one.R = one.R @ Rotation.from_rotvec(xi[:, :3]).as_matrix()
            one.p = one.p + np.einsum("nij,nj->ni", one.R, xi[:, 3:])
            one.lasting = one.lasting + lasting
        return one

    before = graph()
    _, v, chi2 = normal_equations(before)
    for _ in range(20):
        step = small * rng.standard_normal(v.shape)
        moved = graph(step[:6], step[6:, :2])
        expected = (v[:6] * step[:6]).sum() + (v[6:, :2] * step[6:, :2]).sum()
        assert 0.5 * (normal_equations(moved)[2] - chi2) == pytest.approx(expected, rel=0.02, abs=1e-4 * small * 1e3)


def on_map(true, node, passes, shares, error=(0.0, 0.0, 0.0), probability=1.0, part=1.0):
    shifts = np.array([true[node] - true[one] + error for one in passes])
    R = np.tile(np.eye(3), (len(passes), 1, 1))
    return SubmapFactor(node, np.array(passes), np.array(shares), R, shifts, TIGHT, probability, part)


def test_a_map_of_one_pass_pulls_as_a_closure_with_it_does():
    rng = np.random.default_rng(3)
    graph = wandered(graph_of(ring(6), LEVEL), rng, size=0.1)
    graph.closures = [replace(between(ring(6), 0, 4, error=(0.1, 0.0, 0.0)), weight=0.9)]
    H, v, chi2 = normal_equations(graph)
    graph.closures = []
    graph.submap_factors = (on_map(ring(6), 4, [0], [1.0], error=(0.1, 0.0, 0.0), part=0.9),)
    H_map, v_map, chi2_map = normal_equations(graph)
    np.testing.assert_allclose(H_map.toarray(), H.toarray(), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(v_map, v, rtol=1e-9, atol=1e-6)
    assert chi2_map == pytest.approx(chi2)


def test_a_node_on_a_map_moves_with_its_passes_by_their_shares():
    true, moved = ring(8, laps=1), np.array([0.0, 0.4, 0.1])
    graph = graph_of(true, LEVEL)
    graph.p[3] += moved

    def of_map():
        graph.submap_factors = (on_map(true, 7, [0, 3], [0.25, 0.75]),)
        chi2 = normal_equations(graph)[2]
        graph.submap_factors = ()
        return chi2 - normal_equations(graph)[2]

    assert of_map() > 1
    graph.p[7] += 0.75 * moved
    assert of_map() == pytest.approx(0.0, abs=1e-8)


def test_maps_in_either_order_of_time_stand_for_half_a_closure_each():
    true = np.concatenate([ring(16), ring(16)])
    graph = graph_of(true, LEVEL, logs=np.repeat([0, 1], 16))
    pairs = [(2, 15), (2, 12), (5, 15), (5, 9), (15, 18)]  # the last one with another log
    graph.closures = [between(true, *pair) for pair in pairs]
    before = on_map(true, 15, [1, 3, 11], [0.3, 0.3, 0.4], part=0.5)  # two of them beside node 2
    after = on_map(true, 2, [12, 14], [0.5, 0.5], part=0.5)
    graph.submap_factors = (before,)
    np.testing.assert_array_equal(graph.on_submaps(), [0.5, 0, 0, 0, 0])
    graph.submap_factors = (before, after)
    np.testing.assert_array_equal(graph.on_submaps(), [1, 0.5, 0, 0, 0])
    np.testing.assert_allclose(counted(graph), [0, 0.5, 1, 1, 1])


def test_two_logs_of_a_loop_at_different_scales_meet_half_way():
    true = np.concatenate([ring(24, laps=1), ring(24, laps=1)])
    logs = np.repeat([0, 1], 24)
    graph = graph_of(np.where(logs[:, None] == 0, 1.02, 0.98) * true, logs=logs, looseness=0.05)
    graph.closures = [between(true, k, k + 24) for k in range(0, 24, 2)]
    solve(graph)
    assert np.diff(graph.lasting[:, 0])[0] == pytest.approx(np.log(1.02 / 0.98), abs=0.003)
    assert graph.lasting[:, 0].mean() == pytest.approx(0.0, abs=1e-4)
    moved = graph.p - graph.p[0] + true[0]
    assert np.abs(moved - true).max() < 0.05


def test_noise_in_the_steps_does_not_shrink_the_map():
    """Loops do not close by chance, and less so the smaller they are: that says nothing of the scale."""
    rng = np.random.default_rng(0)
    true = ring(160, laps=4, radius=20.0)
    noise = 0.1 * rng.standard_normal((len(true) - 1, 3)) * [1, 1, 0]
    walked = np.concatenate([true[:1], true[0] + np.cumsum(np.diff(true, axis=0) + noise, axis=0)])
    graph = graph_of(walked)
    graph.closures = [between(true, k, k + 40) for k in range(120)]
    solve(graph)
    assert abs(graph.lasting[0, 0]) < 0.01
    assert np.linalg.norm(graph.p[20] - graph.p[0]) == pytest.approx(40.0, rel=0.02)


def test_a_turn_rate_that_lasts_is_found():
    true, rate = ring(24), 0.004
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1))])
    steps = Rotation.from_rotvec(rate * (walked[1:] + walked[:-1])[:, None] / 2 * [0, 0, 1]).apply(
        np.diff(true, axis=0)
    )
    graph = graph_of(np.concatenate([true[:1], true[0] + np.cumsum(steps, axis=0)]), looseness=0.05)
    # Closures say what the true relative pose is in axes that turned on with the odometry.
    axes = Rotation.from_rotvec(rate * walked[:, None] * [0, 0, 1])
    for i, j in [(k, k + 12) for k in range(12)]:
        T = RigidTransform.from_components(axes[i].apply(true[j] - true[i]), axes[i] * axes[j].inv())
        graph.closures = [*graph.closures, Closure(i, j, T, TIGHT, 10.0)]
    solve(graph)
    assert graph.lasting[0, 1] == pytest.approx(-rate, rel=0.1)


def test_covariances_are_those_of_the_dense_inverse():
    true = ring(10)
    graph = graph_of(true)
    graph.closures = [between(true, 0, 5), between(true, 1, 6)]
    solve(graph)
    solve(graph)  # The factors are of where it began: again, they are of where it ends.
    lower = np.tril(normal_equations(graph)[0].toarray())
    C = np.linalg.inv(lower + np.tril(lower, -1).T)
    for k, own in enumerate(graph.marginals()):
        np.testing.assert_allclose(own, C[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], rtol=1e-3, atol=1e-9)
    second = 8
    for first, found in zip([2, 5], graph.relative_covariances(np.array([2, 5]), second), strict=True):
        J = np.zeros((6, len(C)))
        J[:, 6 * second : 6 * second + 6] = np.eye(6)
        J[:, 6 * first : 6 * first + 6] = -adjoint(graph.pose(second).inv() * graph.pose(first))
        np.testing.assert_allclose(found, J @ C @ J.T, rtol=1e-3, atol=1e-9)


def test_revisits_do_not_tell_the_scale_and_what_is_stated_says_so():
    """Errors over stated covariances, of logs whose scale, steps and closures are drawn as they are said to be."""
    true, rng = ring(25, laps=3), np.random.default_rng(4)
    config = SlamConfig(is_planar=True, odometry=OdometryConfig(scale_sd=0.05, turn_share=0.0))
    pairs = [(i, j) for j in range(25) for i in range(j - 5) if np.linalg.norm(true[i] - true[j]) < 1.5]
    nees = []
    for _ in range(60):
        scale = np.exp(0.05 * rng.standard_normal())
        noise = 0.02 * rng.standard_normal(true.shape) * [1, 1, 0]
        graph = graph_of(true / scale + np.cumsum(noise, axis=0), config, looseness=0.2)
        # The map that a closure was found with is made of odometry, so it is in its unit.
        off = np.sqrt(np.diag(TIGHT))[3:] * rng.standard_normal((len(pairs), 3)) * [1, 1, 0]
        graph.closures = [between(true / scale, i, j, error) for (i, j), error in zip(pairs, off, strict=True)]
        solve(graph)
        for node in (4, 12, 20):
            e = graph.R[node].T @ (graph.p[node] - graph.p[0] - (true[node] - true[0]))
            C = graph.covariances(np.array([node]))[0, 3:5, 3:5]
            nees.append(e[:2] @ np.linalg.solve(C, e[:2]) / 2)
    assert 0.7 < np.mean(nees) < 1.4


@pytest.mark.parametrize("config", [LEVEL, FREE], ids=["level", "free"])
def test_the_first_node_of_a_component_stays_where_it_was(config):
    true = ring(24, laps=2)
    logs = np.repeat([0, 1], 12)
    T = RigidTransform.from_components([3.0, -2.0, 0.0], Rotation.from_rotvec([0, 0, 0.5]))
    walked = np.concatenate([true[:12], T.apply(true[12:])])
    graph = graph_of(walked, config, logs)
    assert graph.component().tolist() == logs.tolist()
    for k in range(0, 12, 3):
        shift = RigidTransform.from_components(true[k + 12] - true[k], T.rotation.inv())
        graph.closures = [*graph.closures, Closure(k, k + 12, shift, TIGHT, 10.0)]
    solve(graph)
    assert graph.component().tolist() == [0] * 24
    np.testing.assert_allclose(graph.p[0], walked[0], atol=10 * SURE)
    np.testing.assert_allclose(graph.p[12:], true[12:], atol=0.05)
    np.testing.assert_allclose(graph.R[12:], np.tile(T.rotation.inv().as_matrix(), (12, 1, 1)), atol=0.02)


def test_no_odometry_config_makes_the_numbers_infinite():
    config = SlamConfig(odometry=OdometryConfig(sd=(0.0, 0.0), scale_sd=0.0, turn_share=0.0))
    graph = graph_of(ring(8), config)
    solve(graph)
    assert np.isfinite(graph.marginals()).all()


def test_a_log_that_loses_its_last_closure_goes_back_to_a_frame_of_its_own():
    true = ring(24, laps=2)
    walked = true.copy()
    logs = np.repeat([0, 1], 12)
    # Odometry that knows its scale: else it could stretch the logs to reach what is far.
    config = SlamConfig(is_planar=True, odometry=OdometryConfig(scale_sd=0.02))
    graph = graph_of(walked, config, logs=logs, looseness=0.1)
    # Two that contradict each other by far, the one that fits nothing first.
    far = (40.0, 0.0, 0.0)
    graph.closures = [between(true, 0, 12, log_odds=1.0), between(true, 6, 18, far, log_odds=1.0)]
    solve(graph)
    assert not any(c.is_kept for c in graph.closures)
    assert sorted(set(graph.component().tolist())) == [0, 1]
    np.testing.assert_allclose(graph.p, walked, atol=1e-3)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_closures_that_share_windows_are_as_sure_as_the_errors_that_they_have_in_common_allow(n):
    own = 0.3  # of a unit variance; a window's own error is in all closures of that window
    pairs = np.array([(i, j) for j in range(n) for i in range(j)])
    A = np.zeros((len(pairs), n))
    A[np.arange(len(pairs)), pairs[:, 0]], A[np.arange(len(pairs)), pairs[:, 1]] = -1, 1
    exact = np.linalg.pinv(A[:, 1:].T @ np.linalg.inv(own * A @ A.T + (1 - 2 * own) * np.eye(len(pairs))) @ A[:, 1:])
    graph = graph_of(ring(n))
    graph.closures = [replace(between(graph.p, i, j), common=own) for i, j in pairs.tolist()]
    approximate = np.linalg.inv(A[:, 1:].T @ np.diag(counted(graph)) @ A[:, 1:])
    np.testing.assert_allclose(approximate, exact, rtol=1e-9)
