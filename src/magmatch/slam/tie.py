# SPDX-License-Identifier: BSD-3-Clause
"""Closures of one log: candidates of all windows are weighed together along the path; certain ones are kept."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import is_one_pose, product, transform_of, turn_and_shift
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.slam.answer import by_pass, closure_beside, same_answer
from magmatch.slam.bases import Base
from magmatch.slam.candidates import Candidate
from magmatch.slam.chain import Placed, smooth
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.pose_graph import APART, PoseGraph
from magmatch.slam.loop_closure import (
    NODE_COVARIANCE,
    REACH,
    SAME_SHIFT,
    SAME_TURN,
    Expected,
    Rough,
    log_density,
    matches,
)
from magmatch.slam.windows import Path, Window
from magmatch.threads import side_by_side
from magmatch.typing import Indices, Matrix, Scalars

# Candidates of a window that take part.
MOST_CANDIDATES = 12
# Probability that a registration needs. So sure is the graph of a place that it knows.
SURE = DecisionConfig().min_probability
# Divergence of two priors that weigh a pose alike, nats: spreads within a fifth, or places within half a spread.
SAME_PRIOR = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Searched:
    """A stretch that was searched for a window."""

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
    """By how much the expected pose of a window's node has moved: rotation vector and shift."""
    T_log_node = window.T_log_node
    return turn_and_shift(product(T_log_node.inv(), before.T_base_log.inv(), now.T_base_log, T_log_node))


def earlier_passes(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Of some nodes those before a window that do not adjoin it."""
    return np.asarray(nodes[(nodes < window.node) & ~graph.is_one_pass(nodes, window.node)])


def is_known(window: Window, nodes: Indices, graph: PoseGraph) -> bool:
    """Whether the graph knows where a window lies beside one of some nodes, as well as poses are told apart."""
    return bool(graph.sds_of_place(nodes, window.node).min() < SAME_SHIFT * window.length)


def nearby(window: Window, nodes: Indices, graph: PoseGraph) -> Indices:
    """Which of some nodes, on earlier passes, the graph puts a window near."""
    firsts = earlier_passes(window, nodes, graph)
    if not len(firsts) or not window.keeps_shape:
        return firsts[:0]
    apart = np.linalg.norm(graph.p[firsts] - graph.p[window.node], axis=1)
    beyond = (apart - window.path_length / 2 - window.length) / REACH
    # A bound that costs little first: of a long log most are far away.
    for sds in (graph.most_sds_of_place, graph.sds_of_place):
        is_near = beyond <= sds(firsts, window.node)
        firsts, beyond = firsts[is_near], beyond[is_near]
    return np.asarray(firsts)


def expected_beside(window: Window, nodes: Indices, graph: PoseGraph) -> dict[int, Rough]:
    """Where the graph expects a window, as each of some nodes has it."""
    b, found = window.node, {}
    for a, C in zip(nodes.tolist(), graph.relative_covariances(nodes, b), strict=True):
        R = graph.R[a].T @ graph.R[b]
        at = graph.start[a] + graph.R[a].T @ (graph.p[b] - graph.p[a])
        found[a] = Rough(transform_of(R, at - R @ window.center), C)
    return found


def near_candidates(
    window: Window,
    nodes: dict[int, Indices],
    expected: dict[int, Rough],
    searched: dict[int, Searched],
    standing: Collection[int],
    graph: PoseGraph,
    stretch: Callable[[int], Base],
) -> list[Candidate]:
    """Where a window may lie near some nodes of each of some stretches; ``stretch`` gives the base.

    What was searched before, or is known well, is not searched again, and where what was found is still ``standing``
    it is not weighed either.
    """

    def look(a: int) -> list[Candidate]:
        if a in standing:
            return searched[a].found
        base, rough, known = stretch(a), expected[a], None
        if a in searched or rough.is_narrow(window.length):
            known = [c.match.T_base_log for c in searched[a].found] if a in searched else []
            if not known and not base.are_near(rough.T_base_log.apply(window.center)[None], nodes[a])[0]:
                return []
        return _candidates(window, base, rough, graph.center, known, nodes[a])

    found: list[Candidate] = []
    for some in side_by_side(look, expected):
        # Neighbouring stretches see the same poses: each is weighed by the one in whose middle it lies.
        for c in some:
            if not any(_is_same(c, k, graph, window.length) for k in found):
                found.append(c)
    return found


def _is_same(c: Candidate, k: Candidate, graph: PoseGraph, length: float) -> bool:
    """Whether two candidates are one pose beside one pass, which neighbouring stretches led to."""
    if not graph.is_one_pass(c.node, k.node):
        return False
    T_c, T_k = (product(graph.center(one.node), one.T_node_window) for one in (c, k))
    return is_one_pose(T_c, T_k, np.zeros(3), (SAME_SHIFT * length, SAME_TURN))


def far_candidates(window: Window, bases: Sequence[Base], graph: PoseGraph) -> list[Candidate]:
    """Where a window may lie on whole logs, from nowhere; bases in their components' frames."""
    if not window.keeps_shape:
        return []
    volume = sum(base.volume for base in bases)
    return [c for base in bases for c in _candidates(window, base, float(volume), graph.pose)]


def _candidates(
    window: Window,
    base: Base,
    expected: Expected,
    T_base_node: Callable[[int], RigidTransform],
    known: Sequence[RigidTransform] | None = None,
    middle: Indices | None = None,
) -> list[Candidate]:
    found = matches(window, base, expected, known, middle)
    if not found:
        return []
    nodes = base.nodes_near(np.array([match.T_base_log.apply(window.center) for match in found]))
    return [
        Candidate(node, product(T_base_node(node).inv(), match.T_base_log, window.T_log_node), match)
        for node, match in zip(nodes.tolist(), found, strict=True)
    ]


def tie(
    path: Path,
    candidates: list[list[Candidate]],
    graph: PoseGraph,
    paths: Sequence[Path],
    least: float | None = None,
) -> list[Closure]:
    """Closures of a log's windows, in their order, with nodes of any log: those of some probability or more."""
    config = graph.config
    least = config.min_probability if least is None else least
    candidates = [sorted(c, key=lambda k: -k.match.log_odds)[:MOST_CANDIDATES] for c in candidates]
    placed = [[_placed(c, graph) for c in found] for found in candidates]
    steps = [_log_transition(path.first_node + k, candidates, placed, k, graph) for k in range(len(placed) - 1)]
    component = graph.component()
    revisits = [
        _revisit(window, [c.node for c in found if component[c.node] == component[window.node]], graph)
        for window, found in zip(path.windows, candidates, strict=True)
    ]
    shares = smooth(placed, steps, revisits, config.keeps_on)
    closures = []
    for window, found, at, p in zip(path.windows, candidates, placed, shares, strict=True):
        same = same_answer([one.T for one in at], p, window)
        probability = float(p[same].sum())
        if probability >= least:
            odds = float(np.log(probability / max(1 - probability, 1e-12)))
            for passed in by_pass([found[k] for k in same], p[same], graph):
                closures.append(closure_beside(passed, window.node, paths, odds, graph))
    return closures


def _placed(c: Candidate, graph: PoseGraph) -> Placed:
    T = product(graph.pose(c.node), c.T_node_window)
    return Placed(T, c.match.covariance, c.match.log_odds, c.match.log_prior)


def _revisit(window: Window, beside: list[int], graph: PoseGraph) -> float:
    """Probability that a window lies on stretches of its component where candidates were found."""
    return SURE if beside and is_known(window, np.unique(beside), graph) else graph.config.revisit_share


def _log_transition(
    node: int, candidates: list[list[Candidate]], placed: list[list[Placed]], k: int, graph: PoseGraph
) -> Matrix:
    """Log density of the next window's candidates as odometry predicts them from this one's."""
    shape = len(placed[k]), len(placed[k + 1])
    if not all(shape):
        return np.zeros(shape)
    step, Q = graph.odometry(node)
    i, j = np.indices(shape).reshape(2, -1)
    (T, C, at), (T_next, C_next, at_next) = (
        (RigidTransform.concatenate([p.T for p in some]), np.stack([p.covariance for p in some]),
         np.array([c.node for c in found]))
        for some, found in zip(placed[k : k + 2], candidates[k : k + 2], strict=True)
    )  # fmt: skip
    # The stretches they lie on are apart too, by as much odometry as lies between them, or by the graph's.
    steps = 1 + np.minimum(np.abs(at[i] - at_next[j]), APART)
    S = Q * steps[:, None, None] + C[i] + C_next[j]
    return log_density((T * step).inv()[i] * T_next[j], S, graph.config.drifts).reshape(shape)
