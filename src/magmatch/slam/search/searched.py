# SPDX-License-Identifier: BSD-3-Clause
"""Submaps that were searched for a window: what was found there is not searched for again, or not even weighed."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from magmatch.geometry import is_one_pose, product, turn_and_shift
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.loop_closure import NODE_COVARIANCE, REACH, SAME_SHIFT, SAME_TURN, Candidate, Rough
from magmatch.slam.windows import Window
from magmatch.typing import Indices

# Divergence of two priors that weigh a pose alike, nats: spreads within a fifth, or places within half a spread.
SAME_PRIOR = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Searched:
    """A submap that was searched for a window."""

    nodes: Indices  # near which
    expected: Rough  # where
    weighed: Rough | None  # where it was expected when what was found was weighed last; None to weigh it anew
    found: list[Candidate]

    def holds(self, now: Rough, nodes: Indices, window: Window) -> bool:
        """Whether the pose expected now, near some nodes, is within what was searched, but for a tail."""
        if not np.isin(nodes, self.nodes).all():
            return False
        moved = np.linalg.norm(np.split(turn_and_shift(self.expected.off(window, now.T_base_log)), 2), axis=1)
        return bool(np.all(moved + (REACH - 1) * now.largest_sds <= REACH * self.expected.largest_sds))

    def stands(self, now: Rough, window: Window) -> bool:
        """Whether it is expected where it was when it was weighed: the divergence of the two priors is small."""
        if self.weighed is None:
            return False
        drifts = window.config.drifts
        r = turn_and_shift(self.weighed.off(window, now.T_base_log))[drifts]
        before, after = (
            (rough.covariance + NODE_COVARIANCE)[np.ix_(drifts, drifts)] for rough in (self.weighed, now)
        )
        ratio = np.linalg.solve(before, after)
        off = r @ np.linalg.solve(before, r)
        return bool(0.5 * (np.trace(ratio) - len(r) - np.linalg.slogdet(ratio)[1] + off) < SAME_PRIOR)


def distinct_candidates(candidates: Iterable[Candidate], graph: PoseGraph, length: float) -> list[Candidate]:
    """Candidates that are not one pose beside one pass with an earlier one.

    Neighbouring submaps see the same poses: each is weighed by the one in whose middle it lies.
    """
    found: list[Candidate] = []
    for c in candidates:
        if not any(_is_same(c, k, graph, length) for k in found):
            found.append(c)
    return found


def _is_same(c: Candidate, k: Candidate, graph: PoseGraph, length: float) -> bool:
    """Whether two candidates are one pose beside one pass, which neighbouring submaps led to."""
    if not graph.is_one_pass(c.node, k.node):
        return False
    T_c, T_k = (product(graph.center(one.node), one.T_node_window) for one in (c, k))
    return is_one_pose(T_c, T_k, np.zeros(3), (SAME_SHIFT * length, SAME_TURN))
