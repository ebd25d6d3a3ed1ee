# SPDX-License-Identifier: BSD-3-Clause
"""The drift of odometry is learned from the likelihood of closures, with the stated drift as prior."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import fmin

from magmatch.estimation.path_noise import PRIOR_STRETCHES
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.block_cholesky import BlockCholesky
from magmatch.slam.graph.normal_equations import LEAST_LASTING, normal_equations
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.pose_graph import SURE, PoseGraph
from magmatch.slam.windows import Path
from magmatch.typing import Scalars

# Factors whose logarithms are nearer than this are one.
SAME_FACTOR = 0.05


def learned_drift(graph: PoseGraph, paths: Sequence[Path], stated: SlamConfig) -> SlamConfig:
    """Settings with the most likely standard deviations of position and heading, one factor each for all logs.

    The heading's factor is that of its lasting turn rate too: revisits early in a walk show little of the latter, and
    what they leave open would turn all that follows.
    The closures' residuals are those of the graph as it stands; each counts by its weight.
    """
    if not teaches_drift(graph):
        return stated
    # Covariances are sums of a part of each.
    of_shifts, of_turns = (odometry_graph(paths, with_factors(stated, only)).edges.covariance for only in np.eye(2))
    of_neither = SURE**2 * np.eye(6)
    trial = graph.copied()

    def cost(logs: Scalars) -> float:
        a, b = np.exp(2 * logs)
        Q = a * (of_shifts - of_neither) + b * (of_turns - of_neither) + of_neither
        trial.edges, trial.config = replace(graph.edges, covariance=Q), with_factors(stated, np.exp(logs))
        # The stated drift may be a guess, whose logarithm has a standard deviation of 1.
        return 0.5 * float((logs**2).sum()) - log_evidence(trial)

    simplex = np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    found = fmin(cost, simplex[0], xtol=SAME_FACTOR, ftol=SAME_FACTOR, initial_simplex=simplex, disp=False)
    return with_factors(stated, np.exp(found))


def teaches_drift(graph: PoseGraph) -> bool:
    """Whether closures are enough: as many as noise is learned from."""
    return len(graph.closures) >= PRIOR_STRETCHES


def with_factors(config: SlamConfig, factors: Scalars) -> SlamConfig:
    """Settings with other standard deviations of position and heading, by a factor each."""

    def scaled(sd: tuple[float, float]) -> tuple[float, float]:
        return float(factors[0] * sd[0]), float(factors[1] * sd[1])

    odometry = config.odometry.model_copy(update={"sd": scaled(config.odometry.sd)})
    return config.model_copy(
        update={"odometry": odometry, "sd_of_logs": {name: scaled(sd) for name, sd in config.sd_of_logs.items()}}
    )


def log_evidence(graph: PoseGraph) -> float:
    """Log density of odometry and closures, all poses integrated out about where they stand, but for a constant."""
    H, v, chi2 = normal_equations(graph)
    factor = BlockCholesky.of(H)
    log_det_odometry = float(np.linalg.slogdet(graph.edges.covariance)[1].sum())
    log_det_lasting = 2 * len(graph.lasting) * float(np.log(max(graph.config.odometry.turn_rate_sd, LEAST_LASTING)))
    explained = float((v * factor.solve(v[:, :, None])[:, :, 0]).sum())
    return -0.5 * (chi2 - explained + factor.log_determinant + log_det_odometry + log_det_lasting)
