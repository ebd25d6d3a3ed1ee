# SPDX-License-Identifier: BSD-3-Clause
"""Most likely poses by Gauss-Newton, with closures as switchable constraints.

Each closure has a weight, the probability that it is right: from its own odds, and how far the rest of the graph
contradicts it. Poses and weights are found in turn, as a mixture of right and wrong closures is by
expectation-maximisation.
"""

import logging
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, expit

from magmatch.estimation.gauss_newton import perturbed
from magmatch.estimation.pose_prior import UP
from magmatch.geometry import LINEAR_TURN
from magmatch.slam.config import LEAST_KEPT
from magmatch.slam.graph.block_cholesky import BlockCholesky
from magmatch.slam.graph.factors import N_LASTING, Closure, ClosureArrays
from magmatch.slam.graph.normal_equations import counted, normal_equations, odometry_steps, residual_between
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.typing import Mask, Matrix, Scalars, Vector3

log = logging.getLogger(__name__)

# Most steps, the step size within which closures may lose weight, and the one that ends the iteration.
MOST_STEPS, NEAR, SMALL = 40, 1e-2, 1e-3
# Change of a closure's weight that ends it.
SETTLED = 1e-2
# Fixed points of which one may be wrong. To first order their surprise is by how much all else agrees better without
# each, so the wrong one is among the first few; each takes a solution, and phones' logs hold hundreds.
SUSPECTS = 16
# Squared residual of a fixed point that one right one in a thousand exceeds.
SURPRISING = float(chdtri(3, 1e-3))
# Expected squared residual of a right closure.
EXPECTED = 6.0
# Standard deviations of the odometry, stated or learned, that a log bends by in the mean over what holds it: no drift
# does so beyond.
MOST_BENT = 3.0
# Share of what the graph knows of a pair, beyond which it knows it from the closure itself.
ITS_OWN = 0.99


def solve(graph: PoseGraph) -> None:
    """Find the most likely poses; closures that the rest contradicts lose their weight."""
    _bring_together(graph)
    _bring_to_fixed(graph)
    at_first = True
    for _ in range(MOST_STEPS):
        H, v, _ = normal_equations(graph)
        graph.factor = BlockCholesky.of(H)
        xi = -graph.factor.solve(v[:, :, None])[:, :, 0]
        n = len(graph.p)
        xi *= min(1.0, LINEAR_TURN / max(np.abs(xi[:n, :3]).max(), 1e-300))
        graph.R, graph.p = perturbed(graph.R, graph.p, xi[:n])
        graph.lasting = graph.lasting + xi[n:, :N_LASTING]
        moved, changed = np.abs(xi).max(), 0.0
        # Of poses that still move, a contradiction may disappear.
        if moved < NEAR and graph.closures:
            before = graph.as_arrays.weight
            graph.weigh_closures(probabilities(graph, at_first=at_first))
            at_first, changed = False, np.abs(graph.as_arrays.weight - before).max()
        if moved < SMALL and changed < SETTLED:
            break
    _bring_home(graph)


def forget_closures(graph: PoseGraph) -> None:
    """Return to odometry alone."""
    graph.closures = graph.submap_factors = ()
    graph.level = graph.start[:, 2].copy()
    graph.p, graph.R = graph.start.copy(), np.tile(np.eye(3), (len(graph.p), 1, 1))
    graph.lasting = np.zeros_like(graph.lasting)
    solve(graph)


def warn_of_a_wrong_point(graph: PoseGraph, sources: Sequence[str]) -> None:
    """Name the fixed point without which all else agrees best, where they contradict each other or the log.

    A wrong one bends the log so far that those beside it look as wrong: those that look worst are left out in turn.
    """
    f, surprise, found = graph.fixed, graph.surprise_of_fixed(), []
    if f is None or surprise.max() <= SURPRISING:
        return
    for k in np.argsort(-surprise, kind="stable")[:SUSPECTS].tolist():
        without = graph.copied()
        without.fixed = f.only(np.delete(np.arange(len(f.sd)), k)) if len(f.sd) > 1 else None
        solve(without)
        chi2 = normal_equations(without)[2]
        without.fixed = f
        found.append((chi2, k, float(np.linalg.norm(without.off_fixed()[k]))))
    _, k, far = min(found)
    said = "the fixed point of %s lies %.2g m from where all else has the log: a wrong number, time or log?"
    log.warning(said, sources[k], far)


def _bring_together(graph: PoseGraph) -> None:
    """Move logs that were just connected as a whole to where their most certain closure has them.

    Least squares must start near the solution: logs half a turn away would be drawn there one way round by one
    closure and the other way by the next, and stay twisted.
    """
    closures, group = graph.as_arrays, np.arange(len(graph.lasting))
    one, other = graph.log[closures.first], graph.log[closures.second]
    joins = np.flatnonzero(closures.is_kept & (one != other))
    for c in joins[np.argsort(-closures.odds[joins], kind="stable")].tolist():
        stays, moves = sorted((int(group[one[c]]), int(group[other[c]])))
        if stays == moves:
            continue
        first, second = graph.pose(closures.first[c]), graph.pose(closures.second[c])
        # Takes the second node to where the closure has it; the first comes to the second the other way.
        T = first * graph.closures[c].T_first_second * second.inv()
        T = T if group[other[c]] == moves else T.inv()
        if T.rotation.magnitude() > LINEAR_TURN:
            _move(graph, group[graph.log] == moves, T.rotation.as_matrix(), np.zeros(3), T.translation)
        group[group == moves] = stays


def _move(graph: PoseGraph, mine: Mask, R: Matrix, a: Vector3, b: Vector3) -> None:
    """Turn some nodes as a whole, and take the point a of theirs to b."""
    graph.R[mine], graph.p[mine] = R @ graph.R[mine], (graph.p[mine] - a) @ R.T + b
    graph.level[mine] = graph.start[mine, 2] + np.mean(graph.p[mine, 2] - graph.start[mine, 2])


def _bring_to_fixed(graph: PoseGraph) -> None:
    """Move each connected group as a whole to its fixed points: least squares must start near the solution."""
    if graph.fixed is None:
        return
    f, root = graph.fixed, graph.connected()
    seen = graph.seen_at_fixed()[0]
    for r, rows in graph.fixed_by(root).items():
        w = f.sd[rows] ** -2
        a, b = (np.average(points[rows], axis=0, weights=w) for points in (seen, f.position))
        R = np.eye(3)
        if graph.tell_the_frame(rows):
            x, y = seen[rows] - a, f.position[rows] - b
            if graph.config.is_gravity_aligned:
                x, y = x * [1, 1, 0], y * [1, 1, 0]
                # What holds the vertical: a pair of vectors along it that outweighs the rest.
                x, y, w = np.vstack([x, UP]), np.vstack([y, UP]), np.append(w, np.inf)
            R = Rotation.align_vectors(y, x, weights=w)[0].as_matrix()
        _move(graph, root[graph.log] == r, R, a, b)


def _bring_home(graph: PoseGraph) -> None:
    """Return logs whose last closure was rejected to their own frame."""
    component = graph.component()
    for name in graph.scaled_logs():
        k, mine = int(np.argmax(component == name)), component == name
        if np.abs(graph.p[k] - graph.start[k]).max() > SMALL:
            R = graph.R[k].T
            graph.R[mine], graph.p[mine] = R @ graph.R[mine], (graph.p[mine] - graph.p[k]) @ R.T + graph.start[k]


def probabilities(graph: PoseGraph, *, at_first: bool) -> Scalars:
    """Weight of each closure, where all poses are solved for: the probability that it is right, (c,).

    A wrong one makes those beside it look wrong, too. So of those to be rejected only the more surprising half of the
    scale is, before the others are asked again; and one that is rejected is asked again at first only, for a solution
    with new closures.
    """
    closures, component = graph.as_arrays, graph.component()
    surprise, left = surprises(graph)
    # It is contradicted by what the graph has learned since it was found, or by itself, however far the graph bends.
    more = np.maximum(surprise - np.maximum(closures.paid, EXPECTED), np.maximum(left - EXPECTED, 0.0))
    right = expit(closures.odds - 0.5 * more)
    is_out, was_in = right <= LEAST_KEPT, closures.is_kept
    waits = is_out & was_in & (more < more[is_out & was_in].max(initial=0.0) / 2)
    stays = ~is_out & ~was_in & (not at_first)
    # A closure that connects two components no more is contradicted by nothing; nothing speaks for it either.
    is_apart = component[closures.first] != component[closures.second]
    return np.asarray(np.where(waits | stays | is_apart, closures.weight, right))


def strains(graph: PoseGraph) -> Scalars:
    """Bend of each log in standard deviations of its odometry, rms over what can bend it: (logs,)."""
    n, edges, closures = len(graph.lasting), graph.edges, graph.as_arrays
    chi2 = np.zeros(n)
    for _, _, P, r in odometry_steps(graph):
        chi2 += np.bincount(edges.log, np.einsum("em,emk,ek->e", r, P, r), n)
    one, other = graph.log[closures.first], graph.log[closures.second]
    weight = closures.weight * np.where(one == other, 0.5, 1.0)
    n_bent = EXPECTED * (np.bincount(one, weight, n) + np.bincount(other, weight, n))
    if graph.fixed is not None:
        n_bent += 3 * np.bincount(graph.log[graph.fixed.one], minlength=n)
    return np.asarray(np.sqrt(chi2 / np.maximum(n_bent, EXPECTED)))


def surprises(graph: PoseGraph) -> tuple[Scalars, Scalars]:
    """Squared residual of each closure against what the rest of the graph predicts; and if it were believed, (c,)."""
    closures = graph.as_arrays
    return _surprises(graph, closures, graph.relative_covariances_of_closures(), counted(graph))


def surprise_before(graph: PoseGraph, closure: Closure) -> float:
    """Squared residual of a closure that the graph does not have yet; 0 if the graph predicts nothing."""
    first, second = closure.first, closure.second
    component = graph.component()
    if component[first] != component[second]:
        return 0.0
    S = graph.relative_covariances(np.array([first]), second)
    return float(_surprises(graph, ClosureArrays.of([closure]), S, np.zeros(1))[0][0])


def _surprises(graph: PoseGraph, closures: ClosureArrays, S: np.ndarray, counts: Scalars) -> tuple[Scalars, Scalars]:
    """``r' (C + S)^-1 r`` and ``q' C^-1 q`` with ``q = C (C + S)^-1 r``, where closures have no part in r and S.

    C is a closure's covariance, r its residual, S the covariance of its pair. With r = C^(1/2) U z and
    C^(-1/2) S C^(-1/2) = U diag(s) U' where a share c of its information counts, both z and s grow by 1 / (1 - c s)
    without it.
    """
    r = residual_between(graph, closures.first, closures.second, closures.R, closures.t)[0]
    # A residual's shift is in the axes of the first node.
    axes = np.zeros((len(r), 6, 6))
    axes[:, :3, :3] = np.eye(3)
    axes[:, 3:, 3:] = np.swapaxes(graph.R[closures.first], 1, 2) @ graph.R[closures.second]
    root = np.linalg.cholesky(closures.information)
    mine = np.swapaxes(root, 1, 2) @ axes
    s, U = np.linalg.eigh(mine @ S @ np.swapaxes(mine, 1, 2))
    z = np.einsum("eij,ej->ei", np.swapaxes(root @ U, 1, 2), r)
    s = np.maximum(s, 0.0)
    without = 1 - np.minimum(counts[:, None] * s, ITS_OWN)
    believed = without + s
    return (z**2 / (without * believed)).sum(axis=1), (z**2 / believed**2).sum(axis=1)
