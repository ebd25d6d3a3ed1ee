# SPDX-License-Identifier: BSD-3-Clause
"""Decision on loop closures: which of the places where the windows of a log may lie are believed.

Candidates of all windows of a log are weighed together along the path. Neighbouring windows support each other: the
forward-backward algorithm over their poses. The states of a window are its candidate poses and "nowhere among what
was searched". A candidate that follows from the previous one by odometry gains the ratio of odometry's predicted
density to that of the prior.

A closure from nowhere connects two logs, or one whose drift has grown so large that it may be anywhere. All windows
that it puts beside known path have a say. Those that proposed it are the best of many, at the best of many places.
The others were not chosen: if the closure is right, most of them find their place where it says; if not, none does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import logsumexp

from magmatch.geometry import is_one_pose, product, turn_and_shift
from magmatch.slam.config import COMMON, LEAST_KEPT, SURE, SlamConfig
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.graph.pose_graph import APART, PoseGraph
from magmatch.slam.search.loop_closure import NODE_COVARIANCE, Candidate, Match, is_known, log_density
from magmatch.slam.windows import Path, Window
from magmatch.typing import Covariance6, Indices, Matrix, Points, Scalars

# Candidates of a window that take part.
MOST_CANDIDATES = 12
# Poses drawn, to see how likely a window is on known path.
N_DRAWS = 64


def probable_closures(
    path: Path, candidates: list[list[Candidate]], graph: PoseGraph, paths: Sequence[Path], least: float = LEAST_KEPT
) -> list[Closure]:
    """Closures of a log's windows, in their order, with nodes of any log: those more probable than ``least``.

    By default, whatever the graph would keep: it weights closures by their probability, and may reject them.
    """
    config = graph.config
    candidates = [sorted(c, key=lambda k: -k.match.log_odds)[:MOST_CANDIDATES] for c in candidates]
    poses = [[product(graph.pose(c.node), c.T_node_window) for c in found] for found in candidates]
    steps = [_log_transition(path.first_node + k, candidates, poses, k, graph) for k in range(len(poses) - 1)]
    component, revisits = graph.component(), []
    for window, found in zip(path.windows, candidates, strict=True):
        beside = np.unique([c.node for c in found if component[c.node] == component[window.node]]).astype(np.int64)
        revisits.append(SURE if len(beside) and is_known(window, beside, graph) else config.revisit_share)
    shares = smooth([[c.match for c in found] for found in candidates], steps, revisits, config.keeps_on)
    closures = []
    for window, found, at, p in zip(path.windows, candidates, poses, shares, strict=True):
        same = same_answer(at, p, window)
        probability = float(p[same].sum())
        if probability > least:
            odds = float(np.log(probability / max(1 - probability, 1e-12)))
            for passed in by_pass([found[k] for k in same], p[same], graph):
                closures.append(closure_beside(passed, window.node, paths, odds, graph))
    return closures


def smooth(
    windows: Sequence[Sequence[Match]], log_transitions: list[Matrix], revisits: Sequence[float], keeps_on: float
) -> list[Scalars]:
    """Probability of each candidate pose of each window; the remainder to one is that of nowhere.

    ``log_transitions`` (a, b) between neighbouring windows: log density of b's pose as odometry predicts it from a's;
    ``revisits``: for each window, the share of such windows that lie somewhere; ``keeps_on``: of windows that do,
    the share whose next window does too.
    """
    leaves = 1 - keeps_on
    forward: list[Scalars] = []
    steps = []
    for k, (states, revisit) in enumerate(zip(windows, revisits, strict=True)):
        # As many as leave; where a window is known to lie somewhere, whatever the one before did.
        enters = min(leaves * revisit / (1 - revisit), revisit)
        own = np.array([0.0, *(s.log_odds - s.log_prior for s in states)])
        prior = np.array([s.log_prior for s in states])
        if k == 0:
            start = np.concatenate([[np.log(1 - revisit)], np.log(revisit) + prior])
            forward.append(start + own)
            continue
        before = windows[k - 1]
        M = np.full((len(before) + 1, len(states) + 1), np.log(leaves))
        M[0, 0] = np.log1p(-enters)
        M[0, 1:] = np.log(enters) + prior
        if before and states:
            # Odometry may fail as well: a window may leave one place for another.
            M[1:, 1:] = np.logaddexp(np.log(keeps_on) + log_transitions[k - 1], np.log(leaves * revisit) + prior)
        steps.append((M, own))
        forward.append(logsumexp(forward[-1][:, None] + M, axis=0) + own)
    found = [np.zeros(0)] * len(windows)
    backward = np.zeros(len(windows[-1]) + 1)
    for k in range(len(windows) - 1, -1, -1):
        log_p = forward[k] + backward
        found[k] = np.exp(log_p - logsumexp(log_p))[1:]
        if k:
            M, own = steps[k - 1]
            backward = logsumexp(M + (own + backward)[None, :], axis=1)
    return found


def _log_transition(
    node: int, candidates: list[list[Candidate]], poses: list[list[RigidTransform]], k: int, graph: PoseGraph
) -> Matrix:
    """Log density of the next window's candidates as odometry predicts them from this one's."""
    shape = len(poses[k]), len(poses[k + 1])
    if not all(shape):
        return np.zeros(shape)
    step, Q = graph.odometry(node)
    i, j = np.indices(shape).reshape(2, -1)
    (T, C, at), (T_next, C_next, at_next) = (
        (RigidTransform.concatenate(at), np.stack([c.match.covariance for c in found]),
         np.array([c.node for c in found]))
        for at, found in zip(poses[k : k + 2], candidates[k : k + 2], strict=True)
    )  # fmt: skip
    # The stretches they lie on are apart too, by as much odometry as lies between them, or by the graph's.
    steps = 1 + np.minimum(np.abs(at[i] - at_next[j]), APART)
    S = Q * steps[:, None, None] + C[i] + C_next[j]
    return log_density((T * step).inv()[i] * T_next[j], S, graph.config.drifts).reshape(shape)


def same_answer(poses: Sequence[RigidTransform], probabilities: Scalars, window: Window) -> Indices:
    """Candidates that put a window where the most probable one does, most probable first.

    No point of the window is elsewhere by more than a field length, over which the field changes: it may well fit at
    several poses about one place.
    """
    order = np.argsort(-probabilities, kind="stable")
    tolerance = window.length, 2 * window.length / window.path_length
    return order[[is_one_pose(poses[k], poses[order[0]], np.zeros(3), tolerance) for k in order]]


class Weighted(NamedTuple):
    """A candidate and its probability."""

    candidate: Candidate
    probability: float


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


def off_level(config: SlamConfig) -> Covariance6:
    """Covariance between two nodes of the components that gravity and one floor hold: how well they hold them."""
    held = np.diag(NODE_COVARIANCE).copy()
    held[config.drifts] = 0.0
    return 2 * np.diag(held)


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
