# SPDX-License-Identifier: BSD-3-Clause
"""What a window answers: the candidates that say the same, and the closures that they make, one a pass."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import is_one_pose, product, turn_and_shift
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.search.loop_closure import NODE_COVARIANCE
from magmatch.slam.windows import Path, Window
from magmatch.typing import Covariance6, Indices, Scalars

# Share of a closure's covariance that is each window's own: how its path bends, what its sensor saw. Errors of
# simulated closures correlate by so much where they share a window.
COMMON = 1 / 3


class Weighted(NamedTuple):
    """A candidate and its probability."""

    candidate: Candidate
    probability: float


def same_answer(poses: Sequence[RigidTransform], probabilities: Scalars, window: Window) -> Indices:
    """Candidates that put a window where the most probable one does, most probable first.

    No point of the window is elsewhere by more than a field length, over which the field changes: it may well fit at
    several poses about one place.
    """
    order = np.argsort(-probabilities, kind="stable")
    tolerance = window.length, 2 * window.length / window.path_length
    return order[[is_one_pose(poses[k], poses[order[0]], np.zeros(3), tolerance) for k in order]]


def by_pass(candidates: Sequence[Candidate], probabilities: Scalars, graph: PoseGraph) -> list[list[Weighted]]:
    """Candidates by the pass that they lie beside: a third pass of a place is near both earlier ones.

    The first lies beside the first pass. Another pass, all of whose candidates are improbable, speaks against the
    place, and has no say.
    """
    passes: list[list[Weighted]] = []
    for one in map(Weighted, candidates, probabilities.tolist()):
        node = one.candidate.node
        mine = next((p for p in passes if graph.is_one_pass(node, p[0].candidate.node)), None)
        if mine is not None:
            mine.append(one)
        elif not passes or one.candidate.match.log_odds > 0:
            passes.append([one])
    return passes


def closure_beside(
    passed: Sequence[Weighted], node: int, paths: Sequence[Path], log_odds: float, graph: PoseGraph
) -> Closure:
    """Candidates of a node's window beside one pass as a factor: their mean, and the covariance of all of them.

    The first one's node and the path beside it are apart by some odometry. The field sees how far a body leans or is
    above the floor, where the graph has a node upright and level.
    """
    c, config = passed[0].candidate, graph.config
    T, covariance = _mean(passed, graph)
    beside = covariance_beside(paths[graph.log[c.node]], c.node, c.T_node_window, config)
    return Closure(c.node, node, T, covariance + beside + off_level(config), log_odds, common=COMMON)


def off_level(config: SlamConfig) -> Covariance6:
    """Of one node against another: what gravity and one floor leave open of the components that they hold."""
    held = np.diag(NODE_COVARIANCE).copy()
    held[config.drifts] = 0.0
    return 2 * np.diag(held)


def _mean(passed: Sequence[Weighted], graph: PoseGraph) -> tuple[RigidTransform, Covariance6]:
    """Mean of what the field alone says, from the first one's node, and covariance of the mixture."""
    poses = [
        product(graph.center(one.candidate.node), one.candidate.T_node_window, one.candidate.match.T_node_alone)
        for one in passed
    ]
    xi = np.array([turn_and_shift(product(poses[0].inv(), T)) for T in poses])
    w = np.array([one.probability for one in passed])
    mean = w @ xi / w.sum()
    C = np.array([one.candidate.match.covariance_alone for one in passed])
    C += (xi - mean)[:, :, None] * (xi - mean)[:, None, :]
    T_mean = RigidTransform.from_components(mean[3:], Rotation.from_rotvec(mean[:3]))
    T = product(graph.center(passed[0].candidate.node).inv(), poses[0], T_mean)
    return T, np.einsum("k,kij->ij", w / w.sum(), C)
