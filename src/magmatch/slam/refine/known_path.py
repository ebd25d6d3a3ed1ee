# SPDX-License-Identifier: BSD-3-Clause
"""All that was walked in a log, where the graph has it, and the earlier passes of it beside a window."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey
from magmatch.registration.prepared.walk import BIN_LENGTH, bin_along_path, bin_means
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.search.loop_closure import SAME_SHIFT
from magmatch.slam.search.predicted import earlier_passes
from magmatch.slam.windows import Path, Window
from magmatch.typing import Indices, Points, Scalars, Vectors

# Field lengths from a window's path beyond which the field there tells it nothing.
MAP_REACH = 2.0
# Of them, over which a sample's say in the map fades.
FADES = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Beside:
    """Earlier passes beside a window whose places relative to it the graph knows."""

    survey: Survey  # their samples, where the graph has them
    node: Indices  # (n,): of each sample
    passes: Indices  # (k,): a node of each pass, and how large a share it has in the map where the window lies
    shares: Scalars
    nearest: int  # the node that the window's place is known best from


@dataclass(frozen=True, eq=False, slots=True)
class KnownPath:
    """Means along the path of a log."""

    positions: Points  # (n, 3), m: frame of the log's component
    field: Vectors  # (n, 3), T
    node: Indices  # (n,)
    n_averaged: float  # samples of a mean, in the median

    @classmethod
    def of(cls, path: Path, graph: PoseGraph) -> "KnownPath":
        """Of a log, as the graph has it now."""
        side = BIN_LENGTH * path.windows[0].length
        survey, rows = corrected(path, graph), bin_along_path(np.ascontiguousarray(path.survey.positions), side)
        node = path.nodes[path.number[np.unique(rows, return_index=True)[1]]]
        n = float(np.median(np.bincount(rows)))
        return cls(bin_means(survey.positions, rows), bin_means(survey.field, rows), node, n)

    def beside(self, window: Window, graph: PoseGraph, most: int) -> Beside | None:
        """Earlier passes beside a window, those with the largest say; none if there are fewer than two.

        A map of one pass is what the window's closure with it was found on.
        """
        reach, b = MAP_REACH * window.length, window.node
        nodes = earlier_passes(window, np.unique(self.node), graph)
        nodes = nodes[np.linalg.norm(graph.p[nodes] - graph.p[b], axis=1) < window.path_length + reach]
        rows = np.flatnonzero(np.isin(self.node, nodes))
        apart = np.asarray(cKDTree(self.positions[self.node == b]).query(self.positions[rows], 1, 0, 2, reach)[0])
        rows, apart = rows[np.isfinite(apart)], apart[np.isfinite(apart)]
        near = np.unique(self.node[rows])
        if not len(near):
            return None
        sds = graph.sds_of_place(near, b)
        is_known = np.isin(self.node[rows], near[sds < SAME_SHIFT * window.length])
        rows, say = rows[is_known], np.exp(-0.5 * (apart[is_known] / (FADES * window.length)) ** 2)
        passes, shares = _passes(self.node[rows], say, graph, most)
        if len(passes) < 2:
            return None
        survey = Survey(self.positions[rows], self.field[rows])
        return Beside(survey, self.node[rows], passes, shares, int(near[np.argmin(sds)]))


def _passes(node: Indices, say: Scalars, graph: PoseGraph, most: int) -> tuple[Indices, Scalars]:
    """A node of each pass, and its share, from the node and the say of each sample; most say first."""
    says = np.bincount(node, say)
    passes: list[int] = []
    for one in np.argsort(-says, kind="stable")[: np.count_nonzero(says)].tolist():
        if len(passes) < most and not any(graph.is_one_pass(one, other) for other in passes):
            passes.append(one)
    shares = np.array([say[graph.is_one_pass(node, one)].sum() for one in passes])
    return np.array(passes, np.int64), shares / shares.sum()
