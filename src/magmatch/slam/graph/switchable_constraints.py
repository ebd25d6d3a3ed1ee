# SPDX-License-Identifier: BSD-3-Clause
"""Closures as switchable constraints: each has a weight, the probability that it is right.

It follows from the closure's own odds, and from how far the rest of the graph contradicts it.
"""

import numpy as np
from scipy.special import expit

from magmatch.slam.config import LEAST_KEPT
from magmatch.slam.graph.factors import Closure, ClosureArrays
from magmatch.slam.graph.normal_equations import counted, odometry_steps, residual_between
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.typing import Scalars

# Expected squared residual of a right closure.
EXPECTED = 6.0
# Standard deviations of the odometry, stated or learned, that a log bends by in the mean over what holds it: no drift
# does so beyond.
MOST_BENT = 3.0
# Share of what the graph knows of a pair, beyond which it knows it from the closure itself.
ITS_OWN = 0.99


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
