# SPDX-License-Identifier: BSD-3-Clause
"""How well the base's field explains the target's samples under a pose, compared with an unrelated field.

Each sample contributes ``log(eps + (1 - eps) exp(L))`` with
``L = b^2 / 2 V0 - r^2 / 2 V + 3/2 ln(V0 / V)``: r is the residual against the base field, V its expected variance,
b the sample's deviation from the target's median field and V0 that deviation's variance. Samples that the base does
not cover contribute nothing.
"""

from typing import NamedTuple

import numpy as np

from magmatch.compiled import compiled_ahead, record, subroutine
from magmatch.estimation.candidate_poses import CANDIDATE_POSES, CandidatePoses
from magmatch.estimation.pose_prior import FAR2
from magmatch.registration.prepared.prepared_map import MEDIAN_CHI2_3, MEDIAN_CHI2_5, PreparedMap
from magmatch.registration.prepared.raster import RASTER, find_cell, interpolate_field
from magmatch.threads import side_by_side, slices
from magmatch.typing import Points, Scalars, Vectors


class Evidence(NamedTuple):
    """The target's samples for a search, with the likelihood of an unrelated field for each."""

    positions: Points  # (n, 3), m: target's model frame
    field: Vectors  # (n, 3), T: in its axes
    # (n,), T^2: squared deviation from the target's median field, capped so that one magnet does not decide
    deviation2: Scalars
    deviation_variance: float  # T^2: V0, per component
    noise_variance: float  # T^2: both surveys' noise, per component
    # T and T/m, per component: by these, a pose error causes a field error
    field_rms: float
    gradient_rms: float


EVIDENCE = record(Evidence, "f8[:,::1], f8[:,::1], f8[::1], f8, f8, f8, f8")


def weigh_samples(base: PreparedMap, target: PreparedMap) -> Evidence:
    """Collect the target's samples and the scales for scoring a pose."""
    deviation2 = ((target.sample_field - np.median(target.sample_field, axis=0)) ** 2).sum(axis=1)
    noise_variance = base.noise_sd**2 + target.noise_sd**2
    deviation_variance = max(float(np.median(deviation2)) / MEDIAN_CHI2_3, noise_variance)
    # Robust mean of the gradient's square.
    g2 = np.median((target.point_gradient**2).sum(axis=(1, 2))) * 5 / MEDIAN_CHI2_5
    return Evidence(
        positions=target.samples,
        field=target.sample_field,
        deviation2=np.minimum(deviation2, FAR2 * deviation_variance),
        deviation_variance=deviation_variance,
        noise_variance=noise_variance,
        # A rotation by dth about a random axis changes B by |B| dth sqrt(2/3) in norm.
        field_rms=float(np.sqrt((target.sample_field**2).sum(axis=1).mean() * 2 / 3)),
        gradient_rms=float(np.sqrt(g2 / 3)),
    )


def score_poses(
    poses: CandidatePoses,
    sample_rows: np.ndarray,
    evidence: Evidence,
    base: PreparedMap,
    sd_rotation: float,
    sd_translation: float,
    outlier_share: float,
) -> Scalars:
    """Log-likelihood ratio of each pose, summed over the samples (a, s) that judge its anchor's poses.

    The remaining pose error (rad, m) widens the expected residual; ``outlier_share`` of the samples may match
    nothing.
    """
    out, rows, sd = np.zeros(len(poses.rotations)), np.ascontiguousarray(sample_rows), (sd_rotation, sd_translation)

    def score(some: slice) -> None:
        _score(poses.subset(some), rows, evidence, base.raster, *sd, outlier_share, out[some])

    side_by_side(score, slices(len(out)))
    return out


@subroutine
def mixture_ratio(r2, V, b2, V0, outlier_share):  # type: ignore[no-untyped-def]
    """'Mostly explained by the base' over 'unrelated field' for one sample."""
    s = V0 / V
    return outlier_share + (1 - outlier_share) * s * np.sqrt(s) * np.exp(0.5 * (b2 / V0 - r2 / V))


@subroutine
def expected_variance(evidence, sd, d2, sd_rotation, sd_translation):  # type: ignore[no-untyped-def]
    """Residual variance of a sample at squared distance d2 from the anchor of an inaccurate pose."""
    V0, noise, field_rms, gradient_rms = evidence[3:]
    turn2 = sd_rotation * sd_rotation
    V = noise + sd * sd + field_rms * field_rms * turn2
    V += gradient_rms * gradient_rms * (sd_translation * sd_translation + turn2 * d2)
    return V if V < V0 else V0


@compiled_ahead(CANDIDATE_POSES, "i8[:,::1]", EVIDENCE, RASTER, "f8, f8, f8, f8[::1]")
def _score(poses, rows, evidence, raster, sd_rotation, sd_translation, eps, out):  # type: ignore[no-untyped-def]
    (R, pb, anchor, pt), (origin, spacing, values) = poses, raster
    x, b, b2, V0 = evidence.positions, evidence.field, evidence.deviation2, evidence.deviation_variance
    for h in range(len(R)):
        a = anchor[h]
        total, product = 0.0, 1.0
        for q in range(rows.shape[1]):
            n = rows[a, q]
            y0, y1, y2 = x[n, 0] - pt[a, 0], x[n, 1] - pt[a, 1], x[n, 2] - pt[a, 2]
            i, j, k, u, v, w = find_cell(
                values,
                origin,
                spacing,
                pb[h, 0] + R[h, 0, 0] * y0 + R[h, 0, 1] * y1 + R[h, 0, 2] * y2,
                pb[h, 1] + R[h, 1, 0] * y0 + R[h, 1, 1] * y1 + R[h, 1, 2] * y2,
                pb[h, 2] + R[h, 2, 0] * y0 + R[h, 2, 1] * y1 + R[h, 2, 2] * y2,
            )
            if i < 0:
                continue
            bx, by, bz, sd = interpolate_field(values, i, j, k, u, v, w)
            ex = R[h, 0, 0] * b[n, 0] + R[h, 0, 1] * b[n, 1] + R[h, 0, 2] * b[n, 2] - bx
            ey = R[h, 1, 0] * b[n, 0] + R[h, 1, 1] * b[n, 1] + R[h, 1, 2] * b[n, 2] - by
            ez = R[h, 2, 0] * b[n, 0] + R[h, 2, 1] * b[n, 1] + R[h, 2, 2] * b[n, 2] - bz
            d2 = y0 * y0 + y1 * y1 + y2 * y2
            V = expected_variance(evidence, sd, d2, sd_rotation, sd_translation)
            product *= mixture_ratio(ex * ex + ey * ey + ez * ez, V, b2[n], V0, eps)
            if product > 1e100 or product < 1e-100:  # one logarithm for many samples
                total += np.log(product)
                product = 1.0
        out[h] = total + np.log(product)
