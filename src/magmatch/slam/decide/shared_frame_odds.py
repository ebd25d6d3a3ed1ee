# SPDX-License-Identifier: BSD-3-Clause
"""Odds of a closure from nowhere: all windows that it puts beside known path have a say.

It connects two logs, or one whose drift has grown so large that it may be anywhere.
Windows that proposed the closure are the best of many, at the best of many places. The others were not chosen: if the
closure is right, most of them find their place where it says; if it is wrong, none does.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.windows import Window
from magmatch.typing import Points

# Poses drawn, to see how likely a window is on known path.
N_DRAWS = 64


def log_odds_shared(
    windows: Sequence[Window],
    known: Points,
    found: Sequence[Sequence[Candidate]],
    log_prior: dict[int, float],
    graph: PoseGraph,
) -> float:
    """Log odds (nats) that windows share the frame of known path over that they are unconnected.

    The graph connects the windows to known path, points (n, 3) in the component's frame (m); ``found`` says for
    each where it then lies on that. ``log_prior``: for the nodes that proposed closures, the density of the prior
    that they were found with, from nowhere. One window pays for the transform with that; it predicts the others.
    """
    matches = (max((c.match for c in some), key=lambda m: m.log_odds, default=None) for some in found)
    best = {w.node: m for w, m in zip(windows, matches, strict=True) if m is not None}
    free = {node: best[node].log_odds - best[node].log_prior + log_prior[node] for node in best if node in log_prior}
    if not free:
        return -np.inf
    first = max(free, key=lambda node: free[node])
    rest = [node for node in best if node != first]
    chance = graph.config.keeps_on * _chances_on_path(rest, first, known, windows[0].length, graph)
    odds = np.array([best[node].log_odds for node in rest])
    return float(free[first] + np.logaddexp(np.log1p(-chance), np.log(np.maximum(chance, 1e-300)) + odds).sum())


def _chances_on_path(
    nodes: Sequence[int], connected: int, known: Points, length: float, graph: PoseGraph
) -> np.ndarray:
    """Probability that each node is within a field length of known path, as a node on it sees them."""
    tree, draws = cKDTree(known), np.random.default_rng(0).standard_normal((N_DRAWS, 3))
    chances = []
    for node in nodes:
        C = graph.relative_covariances(np.array([connected]), node)[0][3:, 3:]
        w, V = np.linalg.eigh(C)
        points = graph.p[node] + (draws * np.sqrt(np.maximum(w, 0.0))) @ (graph.R[node] @ V).T
        chances.append(float(np.mean(tree.query(points)[0] < length)))
    return np.array(chances)
