# SPDX-License-Identifier: BSD-3-Clause
"""Predictions of the graph: beside which earlier nodes windows lie, and how well that is known."""

import numpy as np

from magmatch.geometry import transform_of
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.loop_closure import REACH, SAME_SHIFT, Rough
from magmatch.slam.windows import Window
from magmatch.typing import Indices


def earlier_passes(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Select those of some nodes that lie before a window and do not adjoin it."""
    return np.asarray(nodes[(nodes < window.node) & ~graph.is_one_pass(nodes, window.node)])


def is_known(window: Window, nodes: Indices, graph: PoseGraph) -> bool:
    """Whether the graph knows where a window lies beside one of some nodes, as well as poses are told apart."""
    return bool(graph.sds_of_place(nodes, window.node).min() < SAME_SHIFT * window.length)


def nearby(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Select those of some nodes, on earlier passes, that the graph puts a window near."""
    firsts = earlier_passes(window, nodes, graph)
    if not len(firsts) or not window.keeps_shape:
        return firsts[:0]
    apart = np.linalg.norm(graph.p[firsts] - graph.p[window.node], axis=1)
    beyond = (apart - window.path_length / 2 - window.length) / REACH
    return np.asarray(firsts[beyond <= graph.sds_of_place(firsts, window.node)])


def expected_beside(window: Window, nodes: Indices, graph: PoseGraph) -> dict[int, Rough]:
    """Pose of a window that the graph expects relative to each of some nodes."""
    b, found = window.node, {}
    for a, C in zip(nodes.tolist(), graph.relative_covariances(nodes, b), strict=True):
        R = graph.R[a].T @ graph.R[b]
        at = graph.start[a] + graph.R[a].T @ (graph.p[b] - graph.p[a])
        found[a] = Rough(transform_of(R, at - R @ window.center), C)
    return found
