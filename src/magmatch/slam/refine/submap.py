# SPDX-License-Identifier: BSD-3-Clause
"""A window's submap: the earlier or the later passes of its log beside it, where the graph has them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey
from magmatch.geometry import product
from magmatch.registration.prepared.walk import BIN_LENGTH, bin_along_path, bin_means
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.loop_search import MOST_PASSES
from magmatch.slam.search.loop_closure import SAME_SHIFT
from magmatch.slam.windows import Path, Window
from magmatch.typing import Indices, Points, Scalars, Vectors

# Field lengths from a window's path beyond which the field there tells it nothing.
SUBMAP_REACH = 2.0
# Standard deviation, in field lengths, of a sample's weight by its distance from the window's path.
FADES = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class JointSubmap:
    """Passes beside a window whose places relative to it the graph knows."""

    survey: Survey  # their samples, in odometry's frame as it was at the best known node
    node: Indices  # (n,): of each sample
    passes: Indices  # (k,): a node of each pass, and its share in the map where the window lies; the largest first
    shares: Scalars
    best_known: int  # the node relative to which the window's place is known best


@dataclass(frozen=True, eq=False, slots=True)
class KnownPath:
    """Means along the path of a log."""

    positions: Points  # (n, 3), m: frame of the log's component
    field: Vectors  # (n, 3), T
    node: Indices  # (n,)
    n_averaged: float  # samples of a mean, in the median

    @classmethod
    def of(cls, path: Path, graph: PoseGraph) -> "KnownPath":
        """Average a log along its path, as the graph has it now."""
        side = BIN_LENGTH * path.windows[0].length
        survey, rows = corrected(path, graph), bin_along_path(np.ascontiguousarray(path.survey.positions), side)
        node = path.nodes[path.number[np.unique(rows, return_index=True)[1]]]
        n = float(np.median(np.bincount(rows)))
        return cls(bin_means(survey.positions, rows), bin_means(survey.field, rows), node, n)

    def submap(self, window: Window, graph: PoseGraph, *, later: bool) -> JointSubmap | None:
        """Submap of a window, of earlier or of later passes; none if there are fewer than two.

        A map of one pass is what the window's closure with it was found on.
        """
        reach, b = SUBMAP_REACH * window.length, window.node
        nodes = np.arange(b + 1, self.node[-1] + 1) if later else np.arange(self.node[0], b)
        nodes = nodes[~graph.is_one_pass(nodes, b)]
        nodes = nodes[np.linalg.norm(graph.p[nodes] - graph.p[b], axis=1) < window.path_length + reach]
        rows = np.flatnonzero(np.isin(self.node, nodes))
        own = self.positions[self.node == b]
        apart = np.asarray(cKDTree(own).query(self.positions[rows], 1, 0, 2, reach)[0])
        rows, apart = rows[np.isfinite(apart)], apart[np.isfinite(apart)]
        near = np.unique(self.node[rows])
        if not len(near):
            return None
        sds = graph.sds_of_place(near, b)
        is_known = np.isin(self.node[rows], near[sds < SAME_SHIFT * window.length])
        rows, weight = rows[is_known], np.exp(-0.5 * (apart[is_known] / (FADES * window.length)) ** 2)
        passes, shares = _passes(self.node[rows], weight, graph)
        if len(passes) < 2:
            return None
        best = int(near[np.argmin(sds)])
        T_odometry_map = product(graph.center(best), graph.pose(best).inv())
        survey = Survey(self.positions[rows], self.field[rows]).transformed(T_odometry_map)
        return JointSubmap(survey, self.node[rows], passes, shares, best)


def _passes(node: Indices, weight: Scalars, graph: PoseGraph) -> tuple[Indices, Scalars]:
    """A node of each pass, and the pass's share, from the node and the weight of each sample; most weight first."""
    weights, left = np.bincount(node, weight), np.ones(len(node), bool)
    passes: list[int] = []
    shares: list[float] = []
    for one in np.argsort(-weights, kind="stable")[: np.count_nonzero(weights)].tolist():
        if len(passes) < MOST_PASSES and not any(graph.is_one_pass(one, other) for other in passes):
            mine = left & graph.is_one_pass(node, one)
            passes.append(one)
            shares.append(float(weight[mine].sum()))
            left &= ~mine
    return np.array(passes, np.int64), np.array(shares) / sum(shares)
