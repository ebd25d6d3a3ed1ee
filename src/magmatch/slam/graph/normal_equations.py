# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations of all poses from odometry, closures, submaps, fixed points, gravity and the floor.

A node's perturbation has separate rotation and translation: R Exp(phi), p + R rho. Unknowns come in blocks of six:
one for each node, then one for each log, of which the first two are its lasting errors and the others are not used.
"""

import numpy as np
from scipy.sparse import bsr_array
from scipy.spatial.transform import Rotation

from magmatch.geometry import skew
from magmatch.preparation.odometry.drift import LEVEL_SD, UPRIGHT_SD
from magmatch.slam.graph.block_cholesky import SIDE, sum_of_blocks
from magmatch.slam.graph.factors import N_LASTING
from magmatch.slam.graph.pose_graph import FREE, SURE, PoseGraph
from magmatch.typing import Indices, Points, Scalars, Tensors

# Least standard deviation of a lasting error, so that the equations can be solved where it is stated as 0.
LEAST_LASTING = 1e-9
# e rows alike: blocks of unknowns (e, k), Jacobian (e, m, 6 k), information (m, m) or (e, m, m), residual (e, m).
Part = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def normal_equations(graph: PoseGraph) -> tuple[bsr_array, np.ndarray, float]:
    """Information of all unknowns (lower half), the gradient (n, 6) of half their chi^2, and chi^2."""
    n = len(graph.p) + len(graph.lasting)
    parts = [*_alone(graph), *_scale_held(graph), *odometry_steps(graph), *_closures(graph), *_submaps(graph)]
    rows, columns, values, v, chi2 = [], [], [], np.zeros((n, SIDE)), 0.0
    for blocks, J, P, r in parts:
        e, k = blocks.shape
        JP = np.swapaxes(J, 1, 2) @ P
        H = np.swapaxes((JP @ J).reshape(e, k, SIDE, k, SIDE), 2, 3)
        row, column = np.broadcast_arrays(blocks[:, :, None], blocks[:, None, :])
        lower = row >= column
        rows.append(row[lower])
        columns.append(column[lower])
        values.append(H[lower])
        np.add.at(v, blocks, (JP @ r[:, :, None]).reshape(e, k, SIDE))
        chi2 += float(np.einsum("em,em->", r, (P @ r[:, :, None])[:, :, 0]))
    return sum_of_blocks(np.concatenate(rows), np.concatenate(columns), np.concatenate(values), n), v, chi2


def odometry_steps(graph: PoseGraph) -> list[Part]:
    """Steps between neighbouring nodes against the odometry's."""
    e = graph.edges
    if not len(e.first):
        return []
    scale, rate = graph.lasting[e.log].T
    turned = e.lasting[:, :, 1] * rate[:, None]
    Z = Rotation.from_rotvec(turned[:, :3]).as_matrix(), np.zeros((len(e.first), 3))
    r, Ji, Jj = residual_between(graph, e.first, e.second, *Z)
    # What was measured is the real step in the odometry's unit, with noise: were it the measured step, noise and
    # all, that is scaled, loops that do not close would shrink the map.
    unit = np.exp(-scale)[:, None]
    r[:, 3:] *= unit
    Ji[:, 3:] *= unit[:, :, None]
    Jj[:, 3:] *= unit[:, :, None]
    of_scale = -(r * [0, 0, 0, 1, 1, 1])[:, :, None]
    r[:, 3:] -= e.shift + turned[:, 3:]
    unused = np.zeros((len(e.first), SIDE, SIDE - N_LASTING))
    J = np.concatenate([Ji, Jj, of_scale, -e.lasting[:, :, 1:], unused], axis=2)
    return [(np.column_stack([e.first, e.second, len(graph.p) + e.log]), J, e.information, r)]


def _closures(graph: PoseGraph) -> list[Part]:
    closures = graph.as_arrays
    if not len(closures.first):
        return []
    r, Ji, Jj = residual_between(graph, closures.first, closures.second, closures.R, closures.t)
    # A closure that connects two components no more pulls at neither.
    component = graph.component()
    weight = counted(graph) * (component[closures.first] == component[closures.second])
    P = closures.information * weight[:, None, None]
    return [(np.column_stack([closures.first, closures.second]), np.concatenate([Ji, Jj], axis=2), P, r)]


def _submaps(graph: PoseGraph) -> list[Part]:
    """Hold nodes to the mean of where passes of a submap have them, by their shares; submaps of as many at once."""
    found: list[Part] = []
    for k in sorted({len(factor.passes) for factor in graph.submap_factors}):
        some = [factor for factor in graph.submap_factors if len(factor.passes) == k]
        node, passes = np.array([f.node for f in some]), np.array([f.passes for f in some])
        Z = np.array([f.R for f in some]), np.array([f.t for f in some])
        r, J = np.zeros((len(some), SIDE)), np.zeros((len(some), SIDE, SIDE * (k + 1)))
        for i, share in enumerate(np.array([f.shares for f in some]).T):
            ri, Ji, Jj = residual_between(graph, passes[:, i], node, Z[0][:, i], Z[1][:, i])
            # A residual's shift is in the axes of the first node: here all of a factor's are in the second's.
            back = np.swapaxes(graph.R[node], 1, 2) @ graph.R[passes[:, i]]
            for part in (ri[:, :, None], Ji, Jj):
                part[:, 3:] = back @ part[:, 3:]
            r += share[:, None] * ri
            J[:, :, SIDE * i : SIDE * (i + 1)] = share[:, None, None] * Ji
            J[:, :, SIDE * k :] += share[:, None, None] * Jj
        P = np.linalg.inv(np.array([f.covariance for f in some]))
        P *= np.array([f.probability * f.part for f in some])[:, None, None]
        found.append((np.column_stack([passes, node]), J, P, r))
    return found


def _scale_held(graph: PoseGraph) -> list[Part]:
    """The mean scale of each component is held, unless fixed points tell it.

    Without this, a map shrinks or grows by what covariances of closures or of odometry are too small, and they would
    say that the scale is known.
    """
    found: list[Part] = []
    for logs in graph.scaled_logs().values():
        J = np.zeros((1, 1, SIDE * len(logs)))
        J[:, :, ::SIDE] = 1 / len(logs)
        mean = graph.lasting[logs, 0].mean()
        found.append((len(graph.p) + logs[None], J, np.eye(1) / SURE**2, np.array([[mean]])))
    return found


def counted(graph: PoseGraph) -> Scalars:
    """Share of each closure's information that counts: its weight, less what closures of its windows have in common.

    Information that submap factors stand for does not count.
    """
    return np.asarray(graph.as_arrays.weight / shared(graph) * (1 - graph.on_submaps()))


def shared(graph: PoseGraph) -> Scalars:
    """Factor on each closure's covariance, as closures of its windows have a part in common.

    Where n windows all have closures with one another, covariances that are larger by (n - 2) times their common
    share give all relative poses the covariance that is exact.
    """
    closures, n = graph.as_arrays, len(graph.p)
    at_node = np.bincount(closures.first, closures.weight, n) + np.bincount(closures.second, closures.weight, n)
    others = np.maximum((at_node[closures.first] + at_node[closures.second]) / 2 - 1, 0.0)
    return np.asarray(1 + closures.common * others)


def _alone(graph: PoseGraph) -> list[Part]:
    """Priors on single nodes (vertical, height, first node of a component) and on constant errors."""
    n, c = len(graph.p), graph.config
    every = np.arange(n)[:, None]
    found: list[Part] = []
    if c.is_gravity_aligned:
        up = graph.R[:, 2, :]  # the map's vertical in the node's axes
        J = np.concatenate([skew(up), np.zeros((n, 3, 3))], axis=2)
        found.append((every, J, np.eye(3) / UPRIGHT_SD**2, up - [0.0, 0.0, 1.0]))
    if c.is_planar:
        J = np.concatenate([np.zeros((n, 3)), graph.R[:, 2, :]], axis=1)[:, None, :]
        off = (graph.p[:, 2] - graph.level)[:, None]
        found.append((every, J, np.eye(1) / LEVEL_SD**2, off))
    frames = graph.frames()
    names, first = np.unique(frames[graph.log], return_index=True)
    k = len(first)
    has_fixed = np.isin(names, list(graph.fixed_by(frames)))
    sure = np.where(has_fixed, FREE, SURE)[:, None, None]
    found.append((first[:, None], np.tile(np.eye(6), (k, 1, 1)), np.eye(6) / sure**2, np.zeros((k, 6))))
    if graph.fixed is not None:
        f, (seen, J) = graph.fixed, graph.seen_at_fixed()
        P = np.eye(3) / f.sd[:, None, None] ** 2
        found.append((np.column_stack([f.one, f.other]), J, P, seen - f.position))
    sd, k = np.ones(SIDE), len(graph.lasting)
    sd[:N_LASTING] = np.maximum([c.odometry.scale_sd, c.odometry.turn_rate_sd], LEAST_LASTING)
    errors = np.concatenate([graph.lasting, np.zeros((k, SIDE - N_LASTING))], axis=1)
    found.append((n + np.arange(k)[:, None], np.tile(np.eye(SIDE), (k, 1, 1)), np.diag(sd**-2), errors))
    return found


def residual_between(
    graph: PoseGraph, i: Indices, j: Indices, R: Tensors, t: Points
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual of ``T_i^-1 T_j`` against (R, t), and its slopes with both nodes."""
    Ri, Rj = graph.R[i], graph.R[j]
    Rij = np.swapaxes(Ri, 1, 2) @ Rj
    tij = np.einsum("eji,ej->ei", Ri, graph.p[j] - graph.p[i])
    r = np.concatenate([Rotation.from_matrix(np.swapaxes(R, 1, 2) @ Rij).as_rotvec(), tij - t], axis=1)
    bend = np.eye(3) + 0.5 * skew(r[:, :3])
    Ji, Jj = np.zeros((len(i), 6, 6)), np.zeros((len(i), 6, 6))
    Ji[:, :3, :3], Jj[:, :3, :3] = -bend @ np.swapaxes(Rij, 1, 2), bend
    Ji[:, 3:, :3], Ji[:, 3:, 3:], Jj[:, 3:, 3:] = skew(tij), -np.eye(3), Rij
    return r, Ji, Jj
