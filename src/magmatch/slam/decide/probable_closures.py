# SPDX-License-Identifier: BSD-3-Clause
"""Probable closures of a log: candidates of all its windows are weighed together along the path."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import product
from magmatch.slam.decide.answer import by_pass, closure_beside, same_answer
from magmatch.slam.decide.chain import Placed, smooth
from magmatch.slam.graph.factors import LEAST_KEPT, Closure
from magmatch.slam.graph.pose_graph import APART, PoseGraph
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.search.loop_closure import log_density
from magmatch.slam.search.predicted import SURE, is_known
from magmatch.slam.windows import Path, Window
from magmatch.typing import Matrix

# Candidates of a window that take part.
MOST_CANDIDATES = 12


def probable_closures(
    path: Path,
    candidates: list[list[Candidate]],
    graph: PoseGraph,
    paths: Sequence[Path],
    least: float = LEAST_KEPT,
) -> list[Closure]:
    """Closures of a log's windows, in their order, with nodes of any log: those more probable than ``least``.

    By default, whatever the graph would keep: it weights closures by their probability, and may reject them.
    """
    config = graph.config
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
        if probability > least:
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
