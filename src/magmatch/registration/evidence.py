# SPDX-License-Identifier: BSD-3-Clause
"""What a pose is judged by: cells of the target that agree or disagree with the base's field."""

from dataclasses import dataclass

import numpy as np

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.covariance import joint_covariance
from magmatch.registration.pose_prior import PosePrior
from magmatch.registration.prepared import MEDIAN_CHI2_3, PreparedMap
from magmatch.registration.refinement import RefinedPose
from magmatch.registration.unrelated import UnrelatedField, average_cells, fit_unrelated_field
from magmatch.typing import Matrix

# Neighbouring samples share the map's error; a cell mean is never better than this share of the noise variance.
CORRELATED_NOISE_SHARE = 0.1


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
        Cells in the overlap whose field stands out from the target's mean field, and of these the ones that
        agree and disagree with the base.
    log_evidence : float, nats
        ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C + log prior``: the odds of this pose after
        paying for the search over all poses.
    unexplained : float
        Share of the field's variance that the base leaves unexplained, at its most likely value.
    residual : float
        Robust normalised rms residual over the overlap.
    misfit : float
        Normalised rms of the cells' mean residuals: about 1 when noise and the base's spread explain them.
    """

    pose: RefinedPose
    covariance: Matrix | None
    overlap: float
    n_informative: int
    n_good: int
    n_bad: int
    log_evidence: float
    unexplained: float
    residual: float
    misfit: float

    @property
    def good_share(self) -> float:
        """Share of the informative cells that agree."""
        return self.n_good / self.n_informative if self.n_informative else 0.0


def unrelated_field(base: PreparedMap, target: PreparedMap) -> UnrelatedField:
    """Null hypothesis of a pair: what the target's cells look like on their own."""
    cells = average_cells(target.samples, min(base.lengthscale, target.lengthscale))
    noise_variance = base.noise_sd**2 + target.noise_sd**2
    noise = noise_variance * (1 / cells.counts + CORRELATED_NOISE_SHARE)
    return fit_unrelated_field(cells, cells.mean(target.sample_field), noise, target.lengthscale)


def weigh_pose(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, unrelated: UnrelatedField, prior: PosePrior
) -> PoseEvidence:
    """Count the cells for and against a pose.

    Parameters
    ----------
    base, target : PreparedMap
    pose : RefinedPose
    unrelated : UnrelatedField
        Null hypothesis of this pair.
    prior : PosePrior

    Returns
    -------
    PoseEvidence
    """
    T, cells = pose.T_base_target, unrelated.cells
    expected, sd, _, is_known = base.raster.lookup(transform_points(target.samples, T))
    joint = joint_covariance(pose, 2 * min(base.lengthscale, target.lengthscale))
    covariance = None if joint is None else joint[:6, :6]
    overlap = float(is_known.mean())
    residual = rotate_vectors(pose.sensor.correct(target.sample_field), T) - expected
    rows = np.flatnonzero(cells.mean(is_known[:, None].astype(np.float64))[:, 0] > 0.99)
    if not len(rows):
        return PoseEvidence(pose, covariance, overlap, 0, 0, 0, -np.inf, 1.0, np.inf, np.inf)

    r, map_variance = cells.mean(residual)[rows], cells.mean(sd[:, None] ** 2)[rows, 0]
    log_ratio, unexplained = unrelated.log_ratio(r, map_variance, rows)
    # A sensor that must differ implausibly speaks against the pose.
    log_ratio -= 0.5 * float(((pose.sensor.parameters / pose.sensor_sd) ** 2).sum())
    n2 = ((unrelated.field[rows] - unrelated.field.mean(axis=0)) ** 2).sum(axis=1)
    r2 = (r**2).sum(axis=1)
    V = unrelated.noise[rows] + map_variance + np.median(r2) / MEDIAN_CHI2_3
    is_informative = n2 > 9 * V
    sample_r2 = (residual[is_known] ** 2).sum(axis=1) / (base.noise_sd**2 + target.noise_sd**2 + sd[is_known] ** 2)
    return PoseEvidence(
        pose,
        covariance,
        overlap,
        int(is_informative.sum()),
        int((is_informative & (r2 < np.maximum(12 * V, 0.1 * n2))).sum()),
        int((is_informative & (r2 > np.maximum(24 * V, 0.25 * n2))).sum()),
        log_ratio + _search_price(joint, pose.sensor_sd, prior.log_density(T, pose.center)),
        unexplained,
        float(np.sqrt(np.median(sample_r2) / MEDIAN_CHI2_3)),
        float(np.sqrt(np.mean(r2 / (unrelated.noise[rows] + map_variance)) / 3)),
    )


def _search_price(joint: Matrix | None, sensor_sd: np.ndarray, log_prior: float) -> float:
    """Log of the share of all poses (as the prior allows them) and sensors that the estimate's spread fills."""
    if joint is None:
        return -np.inf
    scale = np.concatenate([np.ones(6), sensor_sd])
    _, log_det = np.linalg.slogdet(joint / np.outer(scale, scale))
    return float(0.5 * log_det + 3 * np.log(2 * np.pi) + log_prior)
