# SPDX-License-Identifier: BSD-3-Clause
"""What odometry says of neighbouring nodes, and how far it may be wrong."""

from collections.abc import Sequence

import numpy as np

from magmatch.data.survey import Survey
from magmatch.slam.bending import bend, lasting_errors
from magmatch.slam.config import SlamConfig
from magmatch.slam.pose_graph import LEVEL_SD, SURE, Edges, PoseGraph
from magmatch.slam.windows import Path

# Points of the path between two nodes that say how odometry bends.
BEND_POINTS = 16
# Tilt that a body on one floor keeps within, rms: a steady carrier's, not a climber's, rad.
MOST_TILT = np.radians(10.0)


def odometry_graph(paths: Sequence[Path], config: SlamConfig) -> PoseGraph:
    """Nodes as odometry has them, each log in its own frame, tied by odometry alone."""
    first, shift, covariance, lasting, logs = [], [], [], [], []
    upright, planar = config.is_gravity_aligned, config.is_planar
    for log, path in enumerate(paths):
        for k in range(len(path.windows) - 1):
            rows = np.unique(np.linspace(path.middles[k], path.middles[k + 1], BEND_POINTS).astype(np.int64))
            points = path.survey.positions[rows]
            loads = bend(points, 0, config.odometry_of(path.survey.name), upright=upright, planar=planar)[-1]
            errors = lasting_errors(points, 0, upright=upright)[-1]
            random = loads[:, : -errors.shape[1]]
            covariance.append(random @ random.T + SURE**2 * np.eye(6))
            lasting.append(errors)
            shift.append(points[-1] - points[0])
            first.append(path.first_node + k)
            logs.append(log)
    at = np.array(first, dtype=np.int64)
    edges = Edges(
        at,
        at + 1,
        np.array(shift).reshape(-1, 3),
        np.array(covariance).reshape(-1, 6, 6),
        np.array(lasting).reshape(-1, 6, 2),
        np.array(logs, dtype=np.int64),
    )
    centers = np.concatenate([p.centers for p in paths])
    log_of_node = np.repeat(np.arange(len(paths)), [len(p.windows) for p in paths])
    return PoseGraph(config, np.tile(np.eye(3), (len(centers), 1, 1)), centers, log_of_node, edges)


def lie_level(surveys: Sequence[Survey]) -> bool:
    """Whether all logs keep one height, as well as one floor is trusted to, and their bodies the same way up."""
    heights = np.concatenate([survey.positions[:, 2] for survey in surveys])
    return float(np.ptp(heights)) <= 2 * LEVEL_SD and all(_stays_upright(survey) for survey in surveys)


def _stays_upright(survey: Survey) -> bool:
    if survey.orientations is None:
        return True
    # The vertical in the body's axes, wherever those point: a sensor need not be mounted upright.
    up = survey.orientations.inv().apply([0.0, 0.0, 1.0])
    return float(np.linalg.norm(up.mean(axis=0))) > float(np.cos(MOST_TILT))
