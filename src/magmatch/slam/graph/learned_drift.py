# SPDX-License-Identifier: BSD-3-Clause
"""The drift of odometry is learned from the likelihood of closures, with the stated drift as prior.

How well walkers marked points is learned from odometry, and from closures once there are any. Marks teach no drift:
one that is mistaken shifts those after it, which looks like drift.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import fmin

from magmatch.registration.prepared.path_noise import PRIOR_STRETCHES
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.normal_equations import LEAST_LASTING, normal_equations
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.pose_graph import SURE, PoseGraph
from magmatch.slam.windows import Path
from magmatch.typing import Matrix, Scalars

# Standard deviation of the stated drift's logarithm: it may be a guess.
STATED_SPREAD = 1.0
# Factors nearer than this share of it are one.
SAME_FACTOR = 0.05


def teaches_drift(graph: PoseGraph) -> bool:
    """Whether closures are enough: as many as noise is learned from."""
    return len(graph.closures) >= PRIOR_STRETCHES


def teaches_marks(graph: PoseGraph) -> bool:
    """Whether as many marked points say more than where their logs lie, which takes two of each."""
    if graph.fixed is None:
        return False
    of_log = np.bincount(graph.log[graph.fixed.one[graph.fixed.is_marked]])
    return int(np.maximum(of_log - 2, 0).sum()) >= PRIOR_STRETCHES


def learned_drift(graph: PoseGraph, paths: Sequence[Path], stated: SlamConfig) -> SlamConfig:
    """Settings with the most likely standard deviations of odometry, if closures teach them, and of marks."""
    config = _likely_drift(graph, paths, stated) if teaches_drift(graph) else stated
    return _likely_marks(graph, paths, config) if teaches_marks(graph) else config


def _likely_drift(graph: PoseGraph, paths: Sequence[Path], stated: SlamConfig) -> SlamConfig:
    """Settings with the most likely standard deviations of position and heading, one factor each for all logs.

    The heading's factor is that of its lasting turn rate too: revisits early in a walk show little of the latter, and
    what they leave open would turn all that follows.
    The closures' residuals are those of the graph as it stands; each counts by its weight.
    """
    # Covariances are sums of a part of each.
    of_shifts, of_turns = (odometry_graph(paths, _with_factors(stated, only)).edges.covariance for only in np.eye(2))
    of_neither = SURE**2 * np.eye(6)
    trial = graph.copied()
    trial.fixed = None if graph.fixed is None else graph.fixed.only(np.flatnonzero(~graph.fixed.is_marked))

    def cost(logs: Scalars) -> float:
        a, b = np.exp(2 * logs)
        Q = a * (of_shifts - of_neither) + b * (of_turns - of_neither) + of_neither
        trial.edges, trial.config = replace(graph.edges, covariance=Q), _with_factors(stated, np.exp(logs))
        return 0.5 * float((logs**2).sum()) / STATED_SPREAD**2 - log_evidence(trial)

    return _with_factors(stated, np.exp(_least(cost, np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]))))


def _likely_marks(graph: PoseGraph, paths: Sequence[Path], config: SlamConfig) -> SlamConfig:
    """Settings with the most likely standard deviation of marks, where odometry drifts as the settings say."""
    trial, fixed = graph.copied(), graph.fixed
    assert fixed is not None
    trial.edges = odometry_graph(paths, config).edges

    def with_factor(factor: float) -> SlamConfig:
        return config.model_copy(update={"waypoint_sd": factor * config.waypoint_sd})

    def cost(logs: Scalars) -> float:
        trial.config = with_factor(float(np.exp(logs[0])))
        factor = np.where(fixed.is_marked, trial.config.waypoint_sd / graph.config.waypoint_sd, 1.0)
        trial.fixed = replace(fixed, sd=factor * fixed.sd)
        return 0.5 * float(logs[0] ** 2) / STATED_SPREAD**2 - log_evidence(trial)

    return with_factor(float(np.exp(_least(cost, np.array([[0.0], [-1.0]]))[0])))


def _least(cost: Callable[[Scalars], float], simplex: Matrix) -> Scalars:
    """Logarithms of factors that cost least."""
    near, simplex = SAME_FACTOR * STATED_SPREAD, STATED_SPREAD * simplex
    return np.asarray(fmin(cost, simplex[0], xtol=near, ftol=near, initial_simplex=simplex, disp=False))


def log_evidence(graph: PoseGraph) -> float:
    """Log density of odometry and closures, all poses integrated out about where they stand, but for a constant."""
    H, v, chi2 = normal_equations(graph)
    factor = graph.factor(H)
    log_det_odometry = float(np.linalg.slogdet(graph.edges.covariance)[1].sum())
    log_det_marks = 4 * len(graph.lasting) * float(np.log(graph.config.waypoint_sd))
    if graph.fixed is not None:
        # The plan holds no heights.
        log_det_marks += 4 * float(np.log(graph.fixed.sd[graph.fixed.is_marked]).sum())
    log_det_lasting = 2 * len(graph.lasting) * float(np.log(max(graph.config.odometry.turn_rate_sd, LEAST_LASTING)))
    explained = float((v * factor.solve(v[None])[0]).sum())
    return -0.5 * (chi2 - explained + factor.log_determinant + log_det_odometry + log_det_marks + log_det_lasting)


def _with_factors(config: SlamConfig, factors: Scalars) -> SlamConfig:
    def scaled(sd: tuple[float, float]) -> tuple[float, float]:
        return float(factors[0] * sd[0]), float(factors[1] * sd[1])

    odometry = config.odometry.model_copy(update={"sd": scaled(config.odometry.sd)})
    return config.model_copy(
        update={"odometry": odometry, "sd_of_logs": {name: scaled(sd) for name, sd in config.sd_of_logs.items()}}
    )
