# SPDX-License-Identifier: BSD-3-Clause
"""Most likely poses by Gauss-Newton, with closures weighted by the probability that they are right.

Poses and weights are found in turn, as a mixture of right and wrong closures is by expectation-maximisation.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.estimation.gauss_newton import perturbed
from magmatch.estimation.pose_prior import UP
from magmatch.geometry import LINEAR_TURN
from magmatch.slam.graph.factors import N_LASTING
from magmatch.slam.graph.normal_equations import normal_equations
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.switchable_constraints import probabilities

# Most steps, the step size within which closures may lose weight, and the one that ends the iteration.
MOST_STEPS, NEAR, SMALL = 40, 1e-2, 1e-3
# Change of a closure's weight that ends it.
SETTLED = 1e-2
# Fixed points of which one may be wrong. To first order their surprise is by how much all else agrees better without
# each, so the wrong one is among the first few; each takes a solution, and phones' logs hold hundreds.
SUSPECTS = 16


def solve(graph: PoseGraph) -> None:
    """Find the most likely poses; closures that the rest contradicts lose their weight."""
    _bring_to_fixed(graph)
    at_first = True
    for _ in range(MOST_STEPS):
        H, v, _ = normal_equations(graph)
        xi = -graph.factor(H).solve(v[None])[0]
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


def most_contradicted(graph: PoseGraph) -> tuple[int, float]:
    """Find the fixed point without which all else agrees best, and how far it lies from where that has the log, m.

    A wrong one bends the log so far that those beside it look as wrong: those that look worst are left out in turn.
    """
    f = graph.fixed
    assert f is not None
    found = []
    for k in np.argsort(-graph.surprise_of_fixed(), kind="stable")[:SUSPECTS].tolist():
        without = graph.copied()
        without.fixed = f.only(np.delete(np.arange(len(f.sd)), k)) if len(f.sd) > 1 else None
        solve(without)
        chi2 = normal_equations(without)[2]
        without.fixed = f
        found.append((chi2, k, float(np.linalg.norm(without.off_fixed()[k]))))
    return min(found)[1:]


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
        mine = root[graph.log] == r
        graph.R[mine], graph.p[mine] = R @ graph.R[mine], (graph.p[mine] - a) @ R.T + b
        graph.level[mine] = graph.start[mine, 2] + np.mean(graph.p[mine, 2] - graph.start[mine, 2])


def _bring_home(graph: PoseGraph) -> None:
    """Return logs whose last closure was rejected to their own frame."""
    component = graph.component()
    for name in graph.scaled_logs():
        k, mine = int(np.argmax(component == name)), component == name
        if np.abs(graph.p[k] - graph.start[k]).max() > SMALL:
            R = graph.R[k].T
            graph.R[mine], graph.p[mine] = R @ graph.R[mine], (graph.p[mine] - graph.p[k]) @ R.T + graph.start[k]
