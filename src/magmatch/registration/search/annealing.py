# SPDX-License-Identifier: BSD-3-Clause
"""Coarse refinement of many poses at once: annealed Gauss-Newton on the same score that ranked them."""

from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled_ahead, record, subroutine
from magmatch.estimation.candidate_poses import CANDIDATE_POSES, CandidatePoses
from magmatch.field.cholesky.blas import PLAIN, address_of, gemm, gesv
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.raster import RASTER, find_cell, interpolate
from magmatch.registration.search.scoring import EVIDENCE, Evidence, expected_variance, mixture_ratio
from magmatch.threads import side_by_side, slices
from magmatch.typing import Scalars

# Factor of a stage on the pose error allowed; each step halves its variance.
OF_A_STAGE = 0.25


def schedule(stage: int, sd: tuple[float, float]) -> np.ndarray:
    """Pose error allowed (rad, m) at each step of a stage; before the first, a candidate's own."""
    n = round(-2 * np.log2(OF_A_STAGE))
    return np.outer(np.geomspace(OF_A_STAGE**stage, OF_A_STAGE ** (stage + 1), n + 1), sd)


class Room(NamedTuple):
    """Working arrays of the loops."""

    A: np.ndarray  # (6, 6), normal equations
    dx: np.ndarray  # (6,), their right side, then the step
    turns: np.ndarray  # (4, 3, 3), matrices on the way to the step's rotation
    work: np.ndarray  # (4, 13), vectors of one sample
    pivots: np.ndarray  # (7,), of the solution, and whether there is one


ROOM = record(Room, "f8[:,::1], f8[::1], f8[:,:,::1], f8[:,::1], i4[::1]")


def anneal_poses(
    poses: CandidatePoses,
    sample_rows: np.ndarray,
    evidence: Evidence,
    base: PreparedMap,
    schedule: np.ndarray,
    outlier_share: float,
    damping: float = 1.0,
) -> tuple[CandidatePoses, Scalars]:
    """Refine poses while the pose error allowed shrinks: one row (rad, m) of the schedule per step.

    Returns the poses, about the same anchors, and their scores at the last row of the schedule.
    """
    found = poses._replace(rotations=poses.rotations.copy(), anchors_base=poses.anchors_base.copy())
    scores, schedule = np.zeros(len(found.rotations)), np.ascontiguousarray(schedule)
    rows = np.ascontiguousarray(sample_rows)

    def anneal(some: slice) -> None:
        room = Room(np.zeros((6, 6)), np.zeros(6), np.zeros((4, 3, 3)), np.zeros((4, 13)), np.zeros(7, np.int32))
        _anneal(found.subset(some), rows, evidence, base.raster, schedule, outlier_share, damping, scores[some], room)

    side_by_side(anneal, slices(len(scores)))
    return found, scores


@compiled_ahead(CANDIDATE_POSES, "i8[:,::1]", EVIDENCE, RASTER, "f8[:,::1], f8, f8, f8[::1]", ROOM)
def _anneal(poses, rows, evidence, raster, schedule, eps, damping, scores, room):  # type: ignore[no-untyped-def]
    A, dx, pivots = room.A, room.dx, room.pivots
    info, six = address_of(pivots) + 24, np.int32(6)
    for h in range(len(scores)):
        for step in range(len(schedule)):
            turn, shift = schedule[step, 0], schedule[step, 1]
            _normal_equations(h, poses, rows, evidence, raster, eps, turn, shift, room)
            for c in range(3):
                A[c, c] += damping / (turn * turn)
                A[3 + c, 3 + c] += damping / (shift * shift)
            # Symmetric, so Fortran reads the same matrix; damped, so never singular.
            gesv(False, six, np.int32(1), A, six, pivots, dx, six, info)
            _step(h, poses.rotations, poses.anchors_base, dx, 3 * turn, 3 * shift, room.turns)
        last = len(schedule) - 1
        scores[h] = _normal_equations(
            h, poses, rows, evidence, raster, eps, schedule[last, 0], schedule[last, 1], room
        )


@subroutine
def _step(h, R, pb, dx, most_turn, most_shift, turns):  # type: ignore[no-untyped-def]
    """Apply a bounded step to a pose; its rotation by that of a rotation vector (Rodrigues)."""
    turn2, shift2 = 0.0, 0.0
    for c in range(3):
        turn2 += dx[c] * dx[c]
        shift2 += dx[3 + c] * dx[3 + c]
    turned, shifted, angle2 = most_turn / (np.sqrt(turn2) + 1e-300), most_shift / (np.sqrt(shift2) + 1e-300), 0.0
    for c in range(3):
        if turned < 1.0:
            dx[c] *= turned
        if shifted < 1.0:
            dx[3 + c] *= shifted
        pb[h, c] += dx[3 + c]
        angle2 += dx[c] * dx[c]
        # The cross product's matrix; its diagonal stays 0.
        turns[0, (c + 2) % 3, (c + 1) % 3] = dx[c]
        turns[0, (c + 1) % 3, (c + 2) % 3] = -dx[c]
    angle, one, two, n, at = np.sqrt(angle2), 1.0, 0.0, np.int32(3), address_of(turns)
    if angle >= 1e-12:
        one, two = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    # Products of rows are those of Fortran's columns, the other way round.
    gemm(False, PLAIN, PLAIN, n, n, n, 1.0, at, n, at, n, 0.0, at + 72, n)
    for a in range(3):
        for b in range(3):
            turns[2, a, b] = one * turns[0, a, b] + two * turns[1, a, b]
            if a == b:
                turns[2, a, a] = 1.0 + one * turns[0, a, a] + two * turns[1, a, a]
    gemm(False, PLAIN, PLAIN, n, n, n, 1.0, address_of(R) + 72 * h, n, at + 144, n, 0.0, at + 216, n)
    for a in range(3):
        for b in range(3):
            R[h, a, b] = turns[3, a, b]


@subroutine
def _normal_equations(h, poses, rows, evidence, raster, eps, turn, shift, room):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Fill in the weighted normal equations of the left perturbation (dth, dp) about the anchor; gives the score."""
    (R, pb, anchor, pt), (origin, spacing, values) = poses, raster
    x, b, b2, V0 = evidence.positions, evidence.field, evidence.deviation2, evidence.deviation_variance
    total, product, a, A, v = 0.0, 1.0, anchor[h], room.A, room.dx
    y, Rb, o, J = room.work[0], room.work[1], room.work[2], room.work[3]
    for c in range(6):
        v[c] = 0.0
        for d in range(6):
            A[c, d] = 0.0
    for q in range(rows.shape[1]):
        n = rows[a, q]
        x0, x1, x2 = x[n, 0] - pt[a, 0], x[n, 1] - pt[a, 1], x[n, 2] - pt[a, 2]
        for r in range(3):
            y[r] = R[h, r, 0] * x0 + R[h, r, 1] * x1 + R[h, r, 2] * x2
            Rb[r] = R[h, r, 0] * b[n, 0] + R[h, r, 1] * b[n, 1] + R[h, r, 2] * b[n, 2]
        i, j, k, fx, fy, fz = find_cell(values, origin, spacing, pb[h, 0] + y[0], pb[h, 1] + y[1], pb[h, 2] + y[2])
        if i < 0:
            continue
        interpolate(values, spacing, i, j, k, fx, fy, fz, o)
        r2 = (Rb[0] - o[0]) ** 2 + (Rb[1] - o[1]) ** 2 + (Rb[2] - o[2]) ** 2
        d2 = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
        V = expected_variance(evidence, o[3], d2, turn, shift)
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
    return total + np.log(product)
