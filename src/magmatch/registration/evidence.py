# SPDX-License-Identifier: BSD-3-Clause
"""What a pose is judged by: independent cells of the overlap that agree or disagree with the base's field."""

from dataclasses import dataclass

import numpy as np

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.covariance import pose_covariance
from magmatch.registration.prepared import PreparedMap
from magmatch.registration.refinement import RefinedPose
from magmatch.registration.scoring import MEDIAN_CHI2_3
from magmatch.typing import Matrix, Scalars

# Neighbouring samples share the map's error; a cell mean is never better than this share of the noise variance.
CORRELATED_NOISE_SHARE = 0.1
# Model misfit that even right poses show, as a share of the field's own variance.
MISFIT_SHARE = 0.005
# Share of cells that may disagree although the pose is right (moved objects).
OUTLIER_CELL_SHARE = 0.1
# Factors on the cells' variances that are tried.
INFLATIONS = np.geomspace(1.0, 64.0, 13)


@dataclass(frozen=True, eq=False, slots=True)
class PoseEvidence:
    """Statistics of one refined pose.

    Attributes
    ----------
    pose : RefinedPose
    covariance : (6, 6) array or None
        About the pose's centre, target's model axes.
    overlap : float
        Share of the target's samples where the base knows the field.
    n_informative, n_good, n_bad : int
        Cells in the overlap whose field stands out from the target's median field, and of these the ones that
        agree and disagree with the base.
    log_evidence : float, nats
        ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C - ln(volume 8 pi^2)``: the odds of this pose
        after paying for the search over all poses.
    inflation : float
        Factor on the cells' variances that explains them best.
    residual : float
        Robust normalised rms residual over the overlap.
    """

    pose: RefinedPose
    covariance: Matrix | None
    overlap: float
    n_informative: int
    n_good: int
    n_bad: int
    log_evidence: float
    inflation: float
    residual: float

    @property
    def good_share(self) -> float:
        """Share of the informative cells that agree."""
        return self.n_good / self.n_informative if self.n_informative else 0.0


def weigh_pose(base: PreparedMap, target: PreparedMap, pose: RefinedPose) -> PoseEvidence:
    """Count the cells for and against a pose.

    Parameters
    ----------
    base, target : PreparedMap
    pose : RefinedPose

    Returns
    -------
    PoseEvidence
    """
    T = pose.T_base_target
    y = transform_points(target.samples, T)
    expected, sd, _, is_known = base.raster.lookup(y)
    lengthscale = min(base.lengthscale, target.lengthscale)
    covariance = pose_covariance(pose, 2 * lengthscale)
    overlap = float(is_known.mean())
    if not is_known.any():
        return PoseEvidence(pose, covariance, overlap, 0, 0, 0, -np.inf, 1.0, np.inf)

    noise_variance = base.noise_sd**2 + target.noise_sd**2
    deviation = target.sample_field - np.median(target.sample_field, axis=0)
    field_variance = max(float(np.median((deviation**2).sum(axis=1))) / MEDIAN_CHI2_3, noise_variance)
    residual = rotate_vectors(pose.sensor.correct(target.sample_field), T) - expected
    cells, counts = _cells(y[is_known], lengthscale)
    r2 = _cell_mean_power(residual[is_known], cells, counts)
    n2 = _cell_mean_power(deviation[is_known], cells, counts)
    map_variance = np.bincount(cells, sd[is_known] ** 2) / counts
    V = noise_variance * (1 / counts + CORRELATED_NOISE_SHARE) + map_variance + MISFIT_SHARE * field_variance
    inflation, log_ratio = _most_likely_inflation(r2, n2, V, field_variance)
    V = inflation * V
    is_informative = n2 > 9 * V
    is_good = is_informative & ((r2 < 12 * V) | (r2 < 0.1 * n2))
    is_bad = is_informative & (r2 > 24 * V) & (r2 > 0.25 * n2)
    sample_r2 = (residual[is_known] ** 2).sum(axis=1) / (noise_variance + sd[is_known] ** 2)
    return PoseEvidence(
        pose,
        covariance,
        overlap,
        int(is_informative.sum()),
        int(is_good.sum()),
        int(is_bad.sum()),
        log_ratio + _search_price(covariance, base.raster.volume),
        inflation,
        float(np.sqrt(np.median(sample_r2) / MEDIAN_CHI2_3)),
    )


def _cells(points: Matrix, side: float) -> tuple[Matrix, Scalars]:
    _, index, counts = np.unique(
        np.floor(points / side).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    return index.ravel(), counts.astype(np.float64)


def _cell_mean_power(vectors: Matrix, cells: Matrix, counts: Scalars) -> Scalars:
    power: Scalars = sum(((np.bincount(cells, vectors[:, c]) / counts) ** 2 for c in range(3)), np.zeros(len(counts)))
    return power


def _most_likely_inflation(r2: Scalars, n2: Scalars, V: Scalars, field_variance: float) -> tuple[float, float]:
    """Common factor on the cells' variances that explains them best, and the log ratio it gives.

    Real recordings (drifting poses, steel that moved, a sensor that swings) follow no map to its stated spread. A
    right pose then shows a moderate factor and keeps most of its evidence; a wrong one needs a factor that makes
    every cell as broad as an unrelated field, and has none left.
    """
    ratios = [_cell_log_ratio(r2, n2, k * V, field_variance) for k in INFLATIONS]
    best = int(np.argmax(ratios))
    return float(INFLATIONS[best]), ratios[best]


def _cell_log_ratio(r2: Scalars, n2: Scalars, V: Scalars, field_variance: float) -> float:
    V0 = np.maximum(field_variance, V)
    L = np.minimum(n2, 9 * V0) / (2 * V0) - r2 / (2 * V) + 1.5 * np.log(V0 / V)
    return float(np.logaddexp(np.log(OUTLIER_CELL_SHARE), np.log1p(-OUTLIER_CELL_SHARE) + L).sum())


def _search_price(covariance: Matrix | None, volume: float) -> float:
    """Log of the share of all poses (positions in the map, all rotations) that this one's uncertainty fills."""
    if covariance is None:
        return -np.inf
    _, log_det = np.linalg.slogdet(2 * np.pi * covariance)
    return float(0.5 * log_det - np.log(max(volume, np.finfo(float).tiny) * 8 * np.pi**2))
