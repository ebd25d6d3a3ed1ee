# SPDX-License-Identifier: BSD-3-Clause
"""How far odometry drifts, learned from closures."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import multivariate_normal

from magmatch.data.survey import Survey
from magmatch.estimation.path_noise import PRIOR_STRETCHES
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import Closure, Edges
from magmatch.slam.graph.learned_drift import learned_drift, log_evidence
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import solve
from magmatch.slam.windows import cut


def test_evidence_of_a_step_that_a_closure_measures_is_that_of_both_errors_together():
    config = SlamConfig(is_gravity_aligned=False, odometry=OdometryConfig(scale_sd=0.0, turn_share=0.0))
    off = np.array([0.002, -0.001, 0.003, 0.05, -0.08, 0.02])
    rng = np.random.default_rng(0)
    C = np.diag([0.01, 0.02, 0.01, 0.05, 0.1, 0.08]) ** 2
    given, expected = [], []
    for size in (0.5, 1.0, 2.0):
        A = size * np.diag([0.01, 0.01, 0.03, 0.1, 0.05, 0.1]) @ (np.eye(6) + 0.2 * rng.normal(size=(6, 6)))
        Q = A @ A.T
        edges = Edges(*(np.array([k]) for k in (0, 1)), np.zeros((1, 3)), Q[None], np.zeros((1, 6, 2)), np.array([0]))
        graph = PoseGraph(config, np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), np.zeros(2, np.int64), edges)
        T = RigidTransform.from_components(off[3:], Rotation.from_rotvec(off[:3]))
        graph.closures = [Closure(0, 1, T, C, 10.0)]
        given.append(log_evidence(graph))
        expected.append(multivariate_normal.logpdf(off, cov=Q + C))
    # Constants do not matter.
    np.testing.assert_allclose(np.diff(given), np.diff(expected), atol=0.02)


def closed(sd, config, n_laps=6, radius=4.0):
    """Graph and path of a circle, its odometry a random walk of known size; and true closures with the lap after."""
    rng, n = np.random.default_rng(3), 200 * n_laps
    s = np.linspace(0, 2 * np.pi * n_laps, n)
    true = radius * np.column_stack([np.cos(s), np.sin(s), 0 * s])
    step = 2 * np.pi * radius * n_laps / n
    turned = np.concatenate([[0.0], np.cumsum(np.radians(sd[1]) * np.sqrt(step / 10) * rng.normal(size=n - 1))])
    turn = Rotation.from_rotvec(turned[:, None] * [0, 0, 1])
    moved = sd[0] * np.sqrt(step / 10) * rng.normal(size=(n - 1, 3)) * [1, 1, 0]
    walked = np.concatenate([np.zeros((1, 3)), np.cumsum(turn[:-1].apply(np.diff(true, axis=0)) + moved, axis=0)])
    field = 1e-6 * rng.normal(size=(n, 3))
    (path,) = cut([Survey(walked, field, times=np.arange(n) * 1.0, name="laps")], 0.5, config)
    p, R, ahead = true[path.middles], turn[path.middles], round(len(path.nodes) / n_laps)
    closures = []
    for a, b in zip(path.nodes[:-ahead].tolist(), path.nodes[ahead:].tolist(), strict=True):
        T = RigidTransform.from_components(R[a].apply(p[b] - p[a]), R[a] * R[b].inv())
        closures.append(Closure(a, b, T, np.diag([0.01] * 3 + [0.02] * 3) ** 2, 10.0))
    return odometry_graph([path], config), path, closures


@pytest.mark.parametrize("stated", [(0.6, 6.0), (0.07, 0.7)])
def test_drift_that_was_stated_wrongly_is_learned_from_closures(stated):
    real = (0.2, 2.0)
    config = SlamConfig(is_planar=True, odometry=OdometryConfig(sd=stated, scale_sd=0.001, turn_share=0.01))
    graph, path, closures = closed(real, config)
    graph.closures = closures
    solve(graph)
    sd = learned_drift(graph, [path], config).odometry.sd
    np.testing.assert_allclose(np.log(sd), np.log(real), atol=np.log(1.4))


def test_a_few_closures_teach_nothing_and_more_teach_all_logs_alike():
    config = SlamConfig(is_planar=True, sd_of_logs={"laps": (0.6, 6.0)})
    graph, path, closures = closed((0.2, 2.0), config)
    for k in range(PRIOR_STRETCHES):
        graph.closures = closures[:k]
        assert learned_drift(graph, [path], config) == config
    graph.closures = closures[:PRIOR_STRETCHES]
    solve(graph)
    learned = learned_drift(graph, [path], config)
    factors = np.array(learned.odometry.sd) / config.odometry.sd
    np.testing.assert_allclose(np.array(learned.sd_of_logs["laps"]) / (0.6, 6.0), factors)
