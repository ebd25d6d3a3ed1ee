# SPDX-License-Identifier: BSD-3-Clause
"""Coarse refinement of many poses at once: annealed Gauss-Newton on the same score that ranked them."""

import numpy as np
from numba import njit

from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.raster import find_cell, interpolate
from magmatch.registration.search.scoring import Evidence, expected_variance, mixture_ratio
from magmatch.threads import side_by_side, slices
from magmatch.typing import Points, Scalars, Tensors


def anneal_poses(
    rotations: Tensors,
    anchors_base: Points,
    anchor_rows: np.ndarray,
    anchors_target: Points,
    sample_rows: np.ndarray,
    evidence: Evidence,
    base: PreparedMap,
    schedule: np.ndarray,
    outlier_share: float,
    damping: float,
) -> tuple[Tensors, Points, Scalars]:
    """Refine poses while the inaccuracy that is granted to them shrinks.

    Returns
    -------
    rotations : (h, 3, 3) array
    anchors_base : (h, 3) array, m
    scores : (h,) array
        At the last row's inaccuracy.
    """
    R, pb, scores = rotations.copy(), anchors_base.copy(), np.zeros(len(rotations))
    raster, schedule = base.raster, np.ascontiguousarray(schedule)
    scale = np.array([
        evidence.noise_variance, evidence.deviation_variance, outlier_share,
        evidence.field_rms, evidence.gradient_rms, damping,
    ])  # fmt: skip

    def anneal(some: slice) -> None:
        _anneal(
            R[some], pb[some], anchor_rows[some], anchors_target, sample_rows,
            evidence.positions, evidence.field, evidence.deviation2,
            raster.values, raster.origin, raster.spacing, scale, schedule, scores[some],
        )  # fmt: skip

    side_by_side(anneal, slices(len(R)))
    return R, pb, scores


@njit(cache=True, nogil=True)
def _anneal(R, pb, anchor, pt, rows, x, b, b2, values, origin, spacing, scale, schedule, scores):  # type: ignore[no-untyped-def]
    damping = scale[5]
    for h in range(len(R)):
        a = anchor[h]
        for step in range(len(schedule)):
            turn, shift = schedule[step]
            A, v, _ = _normal_equations(
                R[h], pb[h], pt[a], rows[a], x, b, b2, values, origin, spacing, scale, turn, shift
            )
            for c in range(3):
                A[c, c] += damping / turn**2
                A[3 + c, 3 + c] += damping / shift**2
            dx = np.linalg.solve(A, v)
            dx[:3] *= min(1.0, 3 * turn / (np.sqrt((dx[:3] ** 2).sum()) + 1e-300))
            dx[3:] *= min(1.0, 3 * shift / (np.sqrt((dx[3:] ** 2).sum()) + 1e-300))
            R[h] = _rotation(dx[:3]) @ R[h]
            pb[h] += dx[3:]
        turn, shift = schedule[-1]
        _, _, scores[h] = _normal_equations(
            R[h], pb[h], pt[a], rows[a], x, b, b2, values, origin, spacing, scale, turn, shift
        )


@njit(cache=True, nogil=True)
def _normal_equations(R, pb, pt, rows, x, b, b2, values, origin, spacing, scale, turn, shift):  # type: ignore[no-untyped-def]
    """Weighted normal equations of the left perturbation (dth, dp) about the anchor, and the score."""
    noise, V0, eps, field_rms, gradient_rms = scale[0], scale[1], scale[2], scale[3], scale[4]
    A, v, total, product = np.zeros((6, 6)), np.zeros(6), 0.0, 1.0
    y, Rb, o, J = np.zeros(3), np.zeros(3), np.zeros(13), np.zeros(6)
    for n in rows:
        for r in range(3):
            y[r] = R[r, 0] * (x[n, 0] - pt[0]) + R[r, 1] * (x[n, 1] - pt[1]) + R[r, 2] * (x[n, 2] - pt[2])
            Rb[r] = R[r, 0] * b[n, 0] + R[r, 1] * b[n, 1] + R[r, 2] * b[n, 2]
        i, j, k, fx, fy, fz = find_cell(values, origin, spacing, pb[0] + y[0], pb[1] + y[1], pb[2] + y[2])
        if i < 0:
            continue
        interpolate(values, spacing, i, j, k, fx, fy, fz, o)
        r2 = (Rb[0] - o[0]) ** 2 + (Rb[1] - o[1]) ** 2 + (Rb[2] - o[2]) ** 2
        d2 = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
        V = expected_variance(noise, o[3], d2, turn, shift, field_rms, gradient_rms, V0)
        ratio = mixture_ratio(r2, V, b2[n], V0, eps)
        product *= ratio
        if product > 1e100 or product < 1e-100:  # one logarithm for many samples
            total += np.log(product)
            product = 1.0
        weight = (1 - eps / ratio) / V  # posterior share of 'explained by the base'
        for r in range(3):
            g0, g1, g2 = o[4 + 3 * r], o[5 + 3 * r], o[6 + 3 * r]
            # d(R b)/dth = -[Rb]x; d B(p)/dth = -G [y]x; d B(p)/dp = G
            J[0] = g1 * y[2] - g2 * y[1]
            J[1] = g2 * y[0] - g0 * y[2]
            J[2] = g0 * y[1] - g1 * y[0]
            J[3], J[4], J[5] = -g0, -g1, -g2
            if r == 0:
                J[1] += Rb[2]
                J[2] -= Rb[1]
            elif r == 1:
                J[0] -= Rb[2]
                J[2] += Rb[0]
            else:
                J[0] += Rb[1]
                J[1] -= Rb[0]
            e = Rb[r] - o[r]
            for c in range(6):
                wj = weight * J[c]
                v[c] -= wj * e
                for d in range(c + 1):
                    A[c, d] += wj * J[d]
    for c in range(6):
        for d in range(c):
            A[d, c] = A[c, d]
    return A, v, total + np.log(product)


@njit(cache=True, nogil=True)
def _rotation(th):  # type: ignore[no-untyped-def]
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.sqrt((th**2).sum())
    K = np.array([[0.0, -th[2], th[1]], [th[2], 0.0, -th[0]], [-th[1], th[0], 0.0]])
    if angle < 1e-12:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)
