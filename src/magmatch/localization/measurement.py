# SPDX-License-Identifier: BSD-3-Clause
"""What a bin of samples says of each hypothesis: ``z = R^T (B(p) + g c) + M b + nugget``.

g^2 is the variance of what does not repeat from walk to walk, the map's own spread included.
"""

from dataclasses import dataclass, fields

import numpy as np

from magmatch.compiled import compiled
from magmatch.localization.bins import Bin
from magmatch.localization.known_map import KnownMap
from magmatch.localization.state import BIAS, MISFIT, PLACE, SCALE, Bank, Model, N, correct, predict
from magmatch.registration.prepared.raster import find_cell, interpolate


@dataclass(frozen=True, eq=False, slots=True)
class Steps:
    """Bins one after the other, each with the odometry that leads to it, in the axes of the body before.

    Attributes
    ----------
    dR, u, dt : (n, 3, 3), (n, 3) and (n,) arrays
        Turn, shift (m) and time (s) from the bin before.
    z, M : (n, 3) and (n, 3, 3) arrays
        Field (T) in the body's axes, and how a bias enters it.
    R, p : (n, 3, 3) and (n, 3) arrays
        The body in the odometry's frame.
    t, walked : (n,) arrays
        Time (s), and path up to the bin (m).
    """

    dR: np.ndarray
    u: np.ndarray
    dt: np.ndarray
    z: np.ndarray
    M: np.ndarray
    R: np.ndarray
    p: np.ndarray
    t: np.ndarray
    walked: np.ndarray

    @classmethod
    def none(cls) -> "Steps":
        """Before the first bin."""
        return cls(*(np.zeros((0, *shape)) for shape in ((3, 3), (3,), (), (3,), (3, 3), (3, 3), (3,), (), ())))

    def __len__(self) -> int:
        return len(self.t)

    def rows(self, chosen: slice) -> "Steps":
        """Some of them."""
        return Steps(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def then(self, b: Bin, most: int) -> "Steps":
        """These and one more bin, the last so many of them."""
        R0, p0, t0, w0 = (self.R[-1], self.p[-1], self.t[-1], self.walked[-1]) if len(self) else (b.R, b.p, b.t, 0.0)
        u = R0.T @ (b.p - p0)
        new = (R0.T @ b.R, u, b.t - t0, b.z, b.M, b.R, b.p, b.t, w0 + float(np.sqrt(u @ u)))
        parts = (getattr(self, f.name)[-(most - 1) :] for f in fields(self))
        return Steps(*(np.concatenate([old, np.asarray(one)[None]]) for old, one in zip(parts, new, strict=True)))


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """How well each hypothesis foretold each bin, (k, n): chi^2, half its log-determinant, is the place known."""

    chi2: np.ndarray
    half_log_det: np.ndarray
    is_known: np.ndarray

    @classmethod
    def empty(cls, k: int, n: int) -> "Fit":
        """Room for k hypotheses and n bins."""
        return cls(np.zeros((k, n)), np.zeros((k, n)), np.zeros((k, n), dtype=np.bool_))

    def rows(self, chosen: np.ndarray) -> "Fit":
        """Copies of some hypotheses."""
        return Fit(*(getattr(self, f.name)[chosen].copy() for f in fields(self)))

    def joined(self, other: "Fit") -> "Fit":
        """These hypotheses, then others, over the same bins."""
        parts = (np.concatenate([getattr(one, f.name) for one in (self, other)]) for f in fields(self))
        return Fit(*parts)

    def columns(self, chosen: slice) -> "Fit":
        """Some bins."""
        return Fit(*(getattr(self, f.name)[:, chosen] for f in fields(self)))

    def then(self, later: "Fit") -> "Fit":
        """These bins, then later ones."""
        parts = (np.concatenate([getattr(one, f.name) for one in (self, later)], axis=1) for f in fields(self))
        return Fit(*parts)


def follow(bank: Bank, known: KnownMap, model: Model, steps: Steps, *, moves_first: bool) -> Fit:
    """Take hypotheses through some bins; the odometry that leads to the first counts where it moves them."""
    fit, raster = Fit.empty(len(bank.s), len(steps)), known.raster
    _follow(
        steps.dR, steps.u, steps.dt, steps.z, steps.M, moves_first,
        bank.R, bank.p, bank.b, bank.c, bank.s, bank.P, 
        raster.values, raster.origin, raster.spacing, known.up, model,
        fit.chi2, fit.half_log_det, fit.is_known,
    )  # fmt: skip
    return fit


@compiled
def _follow(  # type: ignore[no-untyped-def]
    dR, u, dt, z, M, moves_first, R, p, b, c, s, P,
    values, origin, spacing, up, model, chi2, half_log_det, is_known,
):  # fmt: skip
    out, H, PH, dx = np.zeros(13), np.zeros((3, N)), np.zeros((N, 3)), np.zeros(N)
    for k in range(len(s)):
        for n in range(len(dt)):
            if n > 0 or moves_first:
                predict(k, R, p, c, s, P, dR[n], u[n], dt[n], up, model)
            i, j, m, x, y, w = find_cell(values, origin, spacing, p[k, 0], p[k, 1], p[k, 2])
            is_known[k, n] = i >= 0
            if i >= 0:
                interpolate(values, spacing, i, j, m, x, y, w, out)
                found = update(k, R, p, b, c, s, P, z[n], M[n], out, model, H, PH, dx)
                chi2[k, n], half_log_det[k, n] = found


@compiled
def update(k, R, p, b, c, s, P, z, M, out, model, H, PH, dx):  # type: ignore[no-untyped-def]
    """Correct hypothesis k by a bin where the map's field, sd and gradient are `out`; chi^2, half log-determinant."""
    g = np.sqrt(model.misfit_variance + model.map_factor2 * out[3] ** 2)
    bx, by, bz = out[0] + g * c[k, 0], out[1] + g * c[k, 1], out[2] + g * c[k, 2]
    r0, r1, r2 = 0.0, 0.0, 0.0
    for a in range(3):
        x, y, w = R[k, 0, a], R[k, 1, a], R[k, 2, a]
        r = z[a] - (x * bx + y * by + w * bz) - (M[a, 0] * b[k, 0] + M[a, 1] * b[k, 1] + M[a, 2] * b[k, 2])
        if a == 0:
            r0 = r
        elif a == 1:
            r1 = r
        else:
            r2 = r
        # R^T [B]x, R^T G, M and g R^T.
        H[a, 0], H[a, 1], H[a, 2] = y * bz - w * by, w * bx - x * bz, x * by - y * bx
        for e in range(3):
            H[a, PLACE + e] = x * out[4 + e] + y * out[7 + e] + w * out[10 + e]
            H[a, BIAS + e] = M[a, e]
        H[a, MISFIT], H[a, MISFIT + 1], H[a, MISFIT + 2] = g * x, g * y, g * w
    for i in range(N):
        for a in range(3):
            total = 0.0
            for j in range(SCALE):
                total += P[k, i, j] * H[a, j]
            PH[i, a] = total
    s00, s01, s02, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(SCALE):
        s00 += H[0, j] * PH[j, 0]
        s01 += H[0, j] * PH[j, 1]
        s02 += H[0, j] * PH[j, 2]
        s11 += H[1, j] * PH[j, 1]
        s12 += H[1, j] * PH[j, 2]
        s22 += H[2, j] * PH[j, 2]
    s00 += model.nugget_variance
    s11 += model.nugget_variance
    s22 += model.nugget_variance
    # Inverse of a symmetric matrix of three by its cofactors.
    c00, c01, c02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
    c11, c12, c22 = s00 * s22 - s02 * s02, s01 * s02 - s00 * s12, s00 * s11 - s01 * s01
    det = s00 * c00 + s01 * c01 + s02 * c02
    chi2 = (
        r0 * (c00 * r0 + c01 * r1 + c02 * r2) + r1 * (c01 * r0 + c11 * r1 + c12 * r2)
        + r2 * (c02 * r0 + c12 * r1 + c22 * r2)
    ) / det  # fmt: skip
    factor = max(chi2 / model.gate, 1.0)
    scale = 1 / (det * factor)
    for i in range(N):
        x, y, w = PH[i, 0] * scale, PH[i, 1] * scale, PH[i, 2] * scale
        k0, k1, k2 = x * c00 + y * c01 + w * c02, x * c01 + y * c11 + w * c12, x * c02 + y * c12 + w * c22
        dx[i] = k0 * r0 + k1 * r1 + k2 * r2
        for j in range(i + 1):
            P[k, i, j] -= k0 * PH[j, 0] + k1 * PH[j, 1] + k2 * PH[j, 2]
            P[k, j, i] = P[k, i, j]
    correct(k, R, p, b, c, s, dx)
    return chi2 / factor, 0.5 * np.log(det) + 1.5 * np.log(factor)
