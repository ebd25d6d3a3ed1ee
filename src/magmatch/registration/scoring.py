# SPDX-License-Identifier: BSD-3-Clause
"""How well a pose explains the target's samples by the base's field, against 'an unrelated field'.

Each sample contributes ``log(eps + (1 - eps) exp(L))`` with
``L = b^2 / 2 V0 - r^2 / 2 V + 3/2 ln(V0 / V)``: r is the residual against the base field, V its expected variance,
b the sample's deviation from the target's median field and V0 that deviation's variance. Samples that the base does
not cover say nothing.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from magmatch.registration.prepared import MEDIAN_CHI2_3, PreparedMap
from magmatch.registration.raster import interpolate_field
from magmatch.typing import Points, Scalars, Tensors, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """The target's samples as a search sees them, with what 'unrelated' means for each.

    Attributes
    ----------
    positions : (n, 3) array, m; field : (n, 3) array, T
        Target's model frame.
    deviation2 : (n,) array, T^2
        Squared deviation from the target's median field, capped so that one magnet does not decide.
    deviation_variance : float, T^2
        V0, per component.
    noise_variance : float, T^2
        Both surveys' noise, per component.
    field_rms, gradient_rms : float
        Per component, T and T/m: how a pose error turns into a field error.
    """

    positions: Points
    field: Vectors
    deviation2: Scalars
    deviation_variance: float
    noise_variance: float
    field_rms: float
    gradient_rms: float


def weigh_samples(base: PreparedMap, target: PreparedMap, cap: float = 9.0) -> Evidence:
    """Gather the target's samples and the scales by which a pose is judged.

    Parameters
    ----------
    base, target : PreparedMap
    cap : float
        Largest squared deviation that counts, in units of V0.

    Returns
    -------
    Evidence
    """
    deviation2 = ((target.sample_field - np.median(target.sample_field, axis=0)) ** 2).sum(axis=1)
    noise_variance = base.noise_sd**2 + target.noise_sd**2
    deviation_variance = max(float(np.median(deviation2)) / MEDIAN_CHI2_3, noise_variance)
    g = np.sqrt((target.point_gradient**2).sum(axis=(1, 2)))
    return Evidence(
        positions=target.samples,
        field=target.sample_field,
        deviation2=np.minimum(deviation2, cap * deviation_variance),
        deviation_variance=deviation_variance,
        noise_variance=noise_variance,
        # A turn by dth about a random axis moves B by |B| dth sqrt(2/3) in norm.
        field_rms=float(np.sqrt((target.sample_field**2).sum(axis=1).mean() * 2 / 3)),
        gradient_rms=float(1.3 * np.median(g) / np.sqrt(3)),
    )


def score_poses(
    rotations: Tensors,
    anchors_base: Points,
    anchor_rows: np.ndarray,
    anchors_target: Points,
    sample_rows: np.ndarray,
    evidence: Evidence,
    base: PreparedMap,
    sd_rotation: float,
    sd_translation: float,
    outlier_share: float,
) -> Scalars:
    """Score many poses; a pose turns about its anchor: ``p_base = anchor_base + R (p_target - anchor_target)``.

    Parameters
    ----------
    rotations : (h, 3, 3) array
    anchors_base : (h, 3) array, m
        Where each pose puts its anchor, base model frame.
    anchor_rows : (h,) int array
        Which anchor each pose belongs to.
    anchors_target : (a, 3) array, m
    sample_rows : (a, s) int array
        Which samples judge the poses of each anchor.
    evidence : Evidence
    base : PreparedMap
    sd_rotation, sd_translation : float, rad and m
        How inaccurate the poses still are; widens the expected residual.
    outlier_share : float
        eps, share of samples that may match nothing.

    Returns
    -------
    (h,) array
        Log-likelihood ratios summed over the samples.
    """
    out = np.zeros(len(rotations))
    _score(
        rotations, anchors_base, anchor_rows, anchors_target, sample_rows,
        evidence.positions, evidence.field, evidence.deviation2,
        base.raster.field, base.raster.sd, base.raster.origin, base.raster.spacing,
        np.array([
            evidence.noise_variance, evidence.deviation_variance, outlier_share,
            sd_rotation, sd_translation, evidence.field_rms, evidence.gradient_rms,
        ]),
        out,
    )  # fmt: skip
    return out


@njit(cache=True)
def log_ratio(r2, V, b2, V0, outlier_share):  # type: ignore[no-untyped-def]
    """Log of 'mostly explained by the base' over 'unrelated field' for one sample."""
    L = 0.5 * b2 / V0 - 0.5 * r2 / V + 1.5 * np.log(V0 / V)
    if L > 30:
        return L + np.log(1 - outlier_share)
    return np.log(outlier_share + (1 - outlier_share) * np.exp(L))


@njit(cache=True)
def expected_variance(noise, sd, d2, sd_rotation, sd_translation, field_rms, gradient_rms, V0):  # type: ignore[no-untyped-def]
    """Residual variance of a sample at squared distance d2 from the anchor of an inaccurate pose."""
    turn2 = sd_rotation * sd_rotation
    V = noise + sd * sd + field_rms**2 * turn2 + gradient_rms**2 * (sd_translation**2 + turn2 * d2)
    return min(V, V0)


@njit(cache=True)
def _score(R, pb, anchor, pt, rows, x, b, b2, field, sd, origin, spacing, scale, out):  # type: ignore[no-untyped-def]
    noise, V0, eps, sd_rotation, sd_translation, field_rms, gradient_rms = scale
    p, y, o = np.zeros(3), np.zeros(3), np.zeros(4)
    for h in range(len(R)):
        a = anchor[h]
        total = 0.0
        for q in range(rows.shape[1]):
            n = rows[a, q]
            d2 = 0.0
            for c in range(3):
                y[c] = x[n, c] - pt[a, c]
                d2 += y[c] * y[c]
            for r in range(3):
                p[r] = pb[h, r] + R[h, r, 0] * y[0] + R[h, r, 1] * y[1] + R[h, r, 2] * y[2]
            if not interpolate_field(field, sd, origin, spacing, p, o):
                continue
            r2 = 0.0
            for r in range(3):
                e = R[h, r, 0] * b[n, 0] + R[h, r, 1] * b[n, 1] + R[h, r, 2] * b[n, 2] - o[r]
                r2 += e * e
            V = expected_variance(noise, o[3], d2, sd_rotation, sd_translation, field_rms, gradient_rms, V0)
            total += log_ratio(r2, V, b2[n], V0, eps)
        out[h] = total
