# SPDX-License-Identifier: BSD-3-Clause
"""Odometry factors between neighbouring nodes, and their covariances."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import adjoint
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import N_LASTING, Edges
from magmatch.slam.graph.pose_graph import SURE, PoseGraph
from magmatch.slam.windows import Path, bend, lasting_errors
from magmatch.typing import Covariance6, Matrix, Vector3

# Points of the path between two nodes that say how odometry bends.
BEND_POINTS = 16


def odometry_graph(paths: Sequence[Path], config: SlamConfig) -> PoseGraph:
    """Make the graph of logs that odometry alone connects: each log in its own frame."""
    graph = PoseGraph(config)
    for path in paths:
        follow(path, graph)
    return graph


def follow(path: Path, graph: PoseGraph) -> None:
    """Add the nodes of a log that the graph does not have yet, where odometry leads: the last of all nodes."""
    config, log = graph.config, path.windows[0].log
    known = max(len(graph.p) - path.first_node, 0)
    first = np.arange(max(known - 1, 0), len(path.windows) - 1)
    steps = [_between(path, int(path.middles[k]), int(path.middles[k + 1]), config) for k in first]
    random = [loads[:, :-N_LASTING] for _, loads, _ in steps]
    edges = Edges(
        path.first_node + first,
        path.first_node + first + 1,
        np.array([shift for shift, *_ in steps]).reshape(-1, 3),
        np.array([A @ A.T + SURE**2 * np.eye(6) for A in random]).reshape(-1, 6, 6),
        np.array([lasting for *_, lasting in steps]).reshape(-1, 6, N_LASTING),
        np.full(len(first), log),
    )
    centers = path.centers[known:]
    graph.grow(centers, np.full(len(centers), log), edges)


def covariance_of_end(path: Path, C: Covariance6, config: SlamConfig, *, from_start: bool) -> Covariance6:
    """Covariance of a log's last sample, given that of its last node, C (6, 6) of xi in ``T Exp(xi)``.

    Both are against where the log began: its first sample (``from_start``), or its first node.
    """
    after, loads, _ = _between(path, int(path.middles[-1]), len(path.survey) - 1, config)
    if from_start:
        first = _between(path, 0, int(path.middles[0]), config)[1]
        A = adjoint(RigidTransform.from_translation(path.windows[0].center - path.windows[-1].center))
        C = C + A @ first @ first.T @ A.T
    A = adjoint(RigidTransform.from_translation(-after))
    return np.asarray(A @ C @ A.T + loads @ loads.T)


def covariance_beside(path: Path, node: int, T_node_other: RigidTransform, config: SlamConfig) -> Covariance6:
    """Covariance that odometry adds to a pose which the field shows relative to the path beside it, not to a node.

    The node is the one of the path in whose window the pose lies. Gives (6, 6), of xi in ``T_node_other Exp(xi)``.
    """
    k = node - path.first_node
    rows = np.arange(*np.searchsorted(path.number, [k, k + 1]))
    apart = path.survey.positions[rows] - path.windows[k].center - T_node_other.translation
    beside = int(rows[np.argmin(np.linalg.norm(apart, axis=1))])
    shift, loads, _ = _between(path, int(path.middles[k]), beside, config)
    loads = adjoint(T_node_other.inv() * RigidTransform.from_translation(shift)) @ loads
    return np.asarray(loads @ loads.T)


def _between(path: Path, a: int, b: int, config: SlamConfig) -> tuple[Vector3, Matrix, Matrix]:
    """Shift from one sample to another, and the effects of unit errors and of lasting errors on its end."""
    points = path.survey.positions[np.unique(np.linspace(a, b, BEND_POINTS).astype(np.int64))]
    upright, planar = config.is_gravity_aligned, config.is_planar
    loads = bend(points, 0, config.odometry_of(path.survey.name), upright=upright, planar=planar)[-1]
    # Only the direction of a jump is known: nobody may have moved at all.
    x, rows = path.survey.positions, path.jumps[(path.jumps >= min(a, b)) & (path.jumps < max(a, b))]
    jumped = np.concatenate([np.zeros((len(rows), 3)), x[rows + 1] - x[rows]], axis=1).T
    return points[-1] - points[0], np.hstack([jumped, loads]), lasting_errors(points, 0, upright=upright)[-1]
