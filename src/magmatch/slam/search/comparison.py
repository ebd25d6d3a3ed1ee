# SPDX-License-Identifier: BSD-3-Clause
"""Comparisons of windows with submaps; what an earlier search found there is not searched for again."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.path_noise import PathNoise
from magmatch.geometry import is_one_pose, product, turn_and_shift
from magmatch.runner import Shared
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.loop_closure import (
    NODE_COVARIANCE,
    REACH,
    SAME_SHIFT,
    SAME_TURN,
    Expected,
    Match,
    Rough,
    expected_beside,
    matches,
)
from magmatch.slam.search.submaps import Submap
from magmatch.slam.windows import Window
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Scalars
from magmatch.workers import Task

# A comparison finds nodes of the submap, and poses beside them.
Found = list[tuple[int, Match]]
# Divergence of two priors that weigh a pose alike, nats: spreads within a fifth, or places within half a spread.
SAME_PRIOR = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A node near which a window may lie, and the relative pose."""

    node: int
    T_node_window: RigidTransform
    match: Match

    @classmethod
    def beside(cls, node: int, match: Match, window: Window, T_submap_node: RigidTransform) -> "Candidate":
        """Make one of a match in a submap, beside a node whose pose there is given."""
        return cls(node, product(T_submap_node.inv(), match.T_base_log, window.T_log_node), match)


@single_threaded
def compare(
    window: Window, submap: Submap, expected: Expected, noise: PathNoise,
    known: Sequence[RigidTransform] | None = None, nodes: Indices | None = None,
) -> Found:  # fmt: skip
    """Poses of a window in a submap, most likely first, each with the node of the submap in whose window it lies.

    ``noise``: of walks, as it is known now; ``known``: poses of an earlier search, which need no other; ``nodes``: in
    whose windows it may lie, if not in all.
    """
    # What is known well is not searched for.
    known = [] if known is None and expected.is_narrow(window.length) else known
    if known is not None and not known and nodes is not None and not expected.is_beside(window, submap, nodes):
        return []
    found = matches(window, submap.with_noise(noise), expected, known, nodes)
    if not found:
        return []
    beside = submap.nodes_near(np.array([match.T_base_log.apply(window.center) for match in found]))
    return list(zip(beside.tolist(), found, strict=True))


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
        moved = np.linalg.norm(np.split(_moved(self.expected, now, window), 2), axis=1)
        return bool(np.all(moved + (REACH - 1) * now.largest_sds <= REACH * self.expected.largest_sds))

    def stands(self, now: Rough, window: Window) -> bool:
        """Whether it is expected where it was when it was weighed: the divergence of the two priors is small."""
        if self.weighed is None:
            return False
        drifts = window.config.drifts
        r = _moved(self.weighed, now, window)[drifts]
        before, after = (
            (rough.covariance + NODE_COVARIANCE)[np.ix_(drifts, drifts)] for rough in (self.weighed, now)
        )
        ratio = np.linalg.solve(before, after)
        off = r @ np.linalg.solve(before, r)
        return bool(0.5 * (np.trace(ratio) - len(r) - np.linalg.slogdet(ratio)[1] + off) < SAME_PRIOR)


def _moved(before: Rough, now: Rough, window: Window) -> Scalars:
    """Move of the expected pose of a window's node: rotation vector and shift."""
    T_log_node = window.T_log_node
    return turn_and_shift(product(T_log_node.inv(), before.T_base_log.inv(), now.T_base_log, T_log_node))


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """A window near some nodes of each of some submaps, where the graph expects it; both by the submap's node.

    What was ``searched`` before, or is known well, is not searched again, and where what was found is still
    ``standing`` it is not weighed either.
    """

    window: Window
    nodes: dict[int, Indices]
    expected: dict[int, Rough]
    searched: dict[int, Searched]
    standing: Collection[int]

    @classmethod
    def of(cls, window: Window, nodes: dict[int, Indices], known: dict[int, Searched], graph: PoseGraph) -> "Search":
        """Say what is to be done now, where submaps were searched before."""
        expected = expected_beside(window, np.array(list(nodes), np.int64), graph)
        searched = {a: known[a] for a in expected if a in known and known[a].holds(expected[a], nodes[a], window)}
        standing = {a for a, one in searched.items() if one.stands(expected[a], window)}
        return cls(window, nodes, expected, searched, standing)

    @property
    def open(self) -> list[int]:
        """Submaps that the window is compared with."""
        return [a for a in self.expected if a not in self.standing]

    def comparison(self, a: int, submap: Shared[Submap], noise: PathNoise) -> Task:
        """Make the task that compares the window with a submap, which is given by its node and itself."""
        known = [c.match.T_base_log for c in self.searched[a].found] if a in self.searched else None
        arguments = (self.window, submap, self.expected[a], noise, known, self.nodes[a])
        return Task(f"the comparison of window {self.window.node} with windows {a} and after", arguments)

    def candidates(self, compared: dict[int, Found], graph: PoseGraph) -> list[Candidate]:
        """Candidates on all submaps, where what was found on those that are open is given."""
        found: list[Candidate] = []
        for a in self.expected:
            some = self.searched[a].found if a in self.standing else [
                Candidate.beside(node, match, self.window, graph.center(node)) for node, match in compared[a]
            ]  # fmt: skip
            # Neighbouring submaps see the same poses: each is weighed by the one in whose middle it lies.
            for c in some:
                if not any(_is_same(c, k, graph, self.window.length) for k in found):
                    found.append(c)
        return found

    def done(self, found: list[Candidate]) -> dict[int, Searched]:
        """The submaps, as they are searched now, but for those that stand."""
        after = {}
        for a in self.open:
            here = [c for c in found if c.node in self.nodes[a]]
            before = self.searched.get(a)
            nodes, where = (self.nodes[a], self.expected[a]) if before is None else (before.nodes, before.expected)
            after[a] = Searched(nodes, where, self.expected[a], here)
        return after


def _is_same(c: Candidate, k: Candidate, graph: PoseGraph, length: float) -> bool:
    """Whether two candidates are one pose beside one pass, which neighbouring submaps led to."""
    if not graph.is_one_pass(c.node, k.node):
        return False
    T_c, T_k = (product(graph.center(one.node), one.T_node_window) for one in (c, k))
    return is_one_pose(T_c, T_k, np.zeros(3), (SAME_SHIFT * length, SAME_TURN))
