# SPDX-License-Identifier: BSD-3-Clause
"""Evidence for a pose: cells of the target that agree or disagree with the base's field."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import gammaln

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.prepared.cubes import cube_keys
from magmatch.registration.prepared.drift import field_variance
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import MEDIAN_CHI2_3, PreparedMap, common_length
from magmatch.registration.refine.refinement import RefinedPose
from magmatch.registration.weigh.covariance import joint_covariance
from magmatch.registration.weigh.hypothesis import Kind
from magmatch.registration.weigh.null_model import CellMeans, NullModel, UnrelatedField, average_cells
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vector3, Vectors

# Neighbouring samples share the map's error; a cell mean is never better than this share of the noise variance.
CORRELATED_NOISE_SHARE = 0.1
# Share of a cell's samples that must lie inside the other map for it to count.
WHOLE = 0.99
# Tried shares of cells that have not changed.
UNCHANGED_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.28)


@dataclass(frozen=True, eq=False, slots=True)
class PoseEvidence:
    """Statistics of one refined pose.

    Attributes
    ----------
    covariance : (6, 6) array or None
        About the pose's centre, target's model axes, from the comparison of the fields alone.
    overlap : float
        Fraction of the target's samples where the base knows the field.
    n_informative, n_good : int
        Number of cells in the overlap whose field differs from the target's mean field, and of those that agree with
        the base.
    log_evidence : float, nats
        ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C + log prior``: the log odds of this pose, with
        the penalty for the search over all poses.
    attainable : float, nats
        The same, if the base explained all cells perfectly.
    residual : float
        Robust normalised rms residual over the overlap.
    misfit : float
        Normalised rms of the cells' mean residuals, the larger of both surveys': about 1 when noise and the other
        map's spread explain them.
    unchanged : float
        Share of the cells in the overlap that are used for all figures but `overlap`; the others have changed.
    is_beside_change : bool
        Whether a change of the field was estimated with the pose; cells and residual then refer to what it leaves.
    """

    pose: RefinedPose
    covariance: Matrix | None
    overlap: float
    n_informative: int
    n_good: int
    log_evidence: float
    attainable: float
    residual: float
    misfit: float
    unchanged: float = 1.0
    is_beside_change: bool = False

    @property
    def kind(self) -> Kind:
        """Evidence by cells."""
        return "map"

    @property
    def T_base_target(self) -> RigidTransform:
        """Model frame to model frame."""
        return self.pose.T_base_target

    @property
    def center(self) -> Vector3:
        """Point about which the covariance is stated, m, target's model frame."""
        return self.pose.center

    @property
    def good_share(self) -> float:
        """Share of the informative cells that agree."""
        return self.n_good / self.n_informative if self.n_informative else 0.0


def overlap_weight(share: Scalars | float) -> Scalars:
    """Log prior weight of poses, by the share of the target that each puts inside the base.

    Most of all possible poses barely touch the base, but surveys of the same place usually overlap. The weight is
    the square of the share, proportional to the number of pairs of samples in common.
    """
    return np.asarray(2 * np.log(share))


@dataclass(frozen=True, eq=False, slots=True)
class NullModels:
    """Null hypotheses of a pair: what either survey looks like on its own.

    Attributes
    ----------
    target : NullModel
        Of all its cells.
    base : UnrelatedField
        Which of its cells lie in the overlap depends on the pose.
    side : float, m
        Of the cells.
    noise_variance : float, T^2
        Of one sample of both surveys together.
    """

    target: NullModel
    base: UnrelatedField
    side: float
    noise_variance: float

    def of_base(self, positions: Points, field: Vectors) -> NullModel:
        """Of those samples of the base that a pose puts inside the target."""
        cells = average_cells(positions, self.side)
        return self.base.over(cells, cells.mean(field), _cell_noise(self.noise_variance, cells))


def null_models_of(base: PreparedMap, target: PreparedMap) -> NullModels:
    """State the null hypotheses of a pair; the numbers of either field are the most likely ones."""
    side, noise_variance = common_length(base, target), base.noise_sd**2 + target.noise_sd**2

    def alone(survey: PreparedMap) -> tuple[UnrelatedField, NullModel]:
        cells = average_cells(survey.samples, side)
        field, noise = cells.mean(survey.sample_field), _cell_noise(noise_variance, cells)
        unrelated = UnrelatedField.most_likely(cells, field, noise, survey.correlation_length)
        return unrelated, unrelated.over(cells, field, noise)

    return NullModels(alone(target)[1], alone(base)[0], side, noise_variance)


def _cell_noise(noise_variance: float, cells: CellMeans) -> Scalars:
    return np.asarray(noise_variance * (1 / cells.counts + CORRELATED_NOISE_SHARE))


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """The change of the field between two surveys, under one pose.

    Attributes
    ----------
    field : (n, 3) array, T
        The target's field minus the base's at the target's samples, target's model frame.
    rows : (r,) int array
        Cells that are used; in the others too much has changed.
    unchanged : float
        These as a share of the overlap's cells.
    log_ratio : float, nats
        Log-likelihood ratio of 'the base with this change' to 'an independent field' for these cells, minus the
        penalty for choosing them.
    """

    field: Vectors
    rows: Indices
    unchanged: float
    log_ratio: float


def weigh_pose(
    base: PreparedMap,
    target: PreparedMap,
    pose: RefinedPose,
    nulls: NullModels,
    prior: PosePrior,
    change: Change | None = None,
) -> PoseEvidence:
    """Weigh a pose by the cells for and against it.

    Both surveys' cells are asked. That the target's are explained by the base's map, and the base's by the target's,
    are two estimates of one number, ``log p(both | pose) / p(base) p(target)``: their mean is the better one.

    Parameters
    ----------
    base, target : PreparedMap
    pose : RefinedPose
    nulls : NullModels
        Null hypotheses of this pair.
    prior : PosePrior
    change : Change, optional
        What has changed between the surveys; then the target's cells alone are asked, as it was estimated with them.

    Returns
    -------
    PoseEvidence
    """
    field = pose.sensor.correct(target.sample_field)
    if change is not None:
        field = field - change.field
    null_model = nulls.target
    seen = compare_cells(base, target, pose.T_base_target, field, null_model)
    # From the fields alone: correlated residuals would outweigh the prior in the curvature.
    alone = replace(pose, prior_information=np.zeros((6, 6)))
    joint = joint_covariance(alone, 2 * nulls.side)
    covariance = None if joint is None else joint[:6, :6]
    overlap = float(seen.is_known.mean())
    if not len(seen.rows):
        return PoseEvidence(pose, covariance, overlap, 0, 0, -np.inf, -np.inf, np.inf, np.inf)

    rows = seen.rows if change is None else change.rows
    ratios, misfits = (
        [null_model.log_ratio(seen.residual[rows], seen.map_variance[rows], rows)],
        [seen.misfit(null_model, rows)],
    )
    if change is not None:
        ratios = [(change.log_ratio, ratios[0][1])]
    else:
        of_base, back = compare_back(base, target, pose, nulls)
        if len(back.rows):
            ratios.append(of_base.log_ratio(back.residual, back.map_variance, back.rows))
            misfits.append(back.misfit(of_base, back.rows))
    log_ratio, attainable = np.mean(ratios, axis=0)
    # An implausible difference between the sensors is evidence against the pose.
    log_ratio -= 0.5 * float(((pose.sensor.parameters / pose.sensor_sd) ** 2).sum())
    r2, variance = (seen.residual[rows] ** 2).sum(axis=1), null_model.noise[rows] + seen.map_variance[rows]
    n2 = ((null_model.field[rows] - null_model.field.mean(axis=0)) ** 2).sum(axis=1)
    # The variance stated by noise and map, or that of the residuals: their sum would count one error twice.
    V = np.maximum(variance, np.median(r2) / MEDIAN_CHI2_3)
    is_informative = n2 > 9 * V
    sample_chi2 = seen.sample_chi2[seen.is_known & (True if change is None else null_model.cells.holds(rows))]
    log_prior = prior.log_density(pose.T_base_target, pose.center, covariance)
    price = _search_price(joint, pose.sensor_sd, log_prior) + float(overlap_weight(overlap))
    return PoseEvidence(
        pose,
        covariance,
        overlap,
        int(is_informative.sum()),
        int((is_informative & (r2 < np.maximum(12 * V, 0.1 * n2))).sum()),
        float(log_ratio + price),
        float(attainable + price),
        float(np.sqrt(np.median(sample_chi2) / MEDIAN_CHI2_3)),
        max(misfits),
        1.0 if change is None else change.unchanged,
        change is not None,
    )


@dataclass(frozen=True, eq=False, slots=True)
class CellComparison:
    """The base's field at the target's samples, and averaged over its cells.

    Attributes
    ----------
    is_known : (n,) bool array
        Samples where the base knows the field.
    sample_chi2 : (n,) array
        Squared residual of each sample over its expected variance.
    rows : (r,) int array
        Cells that lie in the overlap.
    residual : (c, 3) array, T
        Mean of each cell.
    map_variance : (c,) array, T^2
        Of the base.
    drift_variance : (c,) array, T^2
        Of one component, through positions that are off by as much as either survey states.
    """

    is_known: Mask
    sample_chi2: Scalars
    rows: Indices
    residual: Vectors
    map_variance: Scalars
    drift_variance: Scalars

    def misfit(self, null_model: NullModel, rows: Indices) -> float:
        """Normalised rms of some cells' residuals: about 1 when noise, map and stated drift explain them."""
        variance = null_model.noise[rows] + self.map_variance[rows] + self.drift_variance[rows]
        return float(np.sqrt(np.mean((self.residual[rows] ** 2).sum(axis=1) / variance) / 3))


def compare_cells(
    base: PreparedMap,
    target: PreparedMap,
    T_base_target: RigidTransform,
    field: Vectors,
    null_model: NullModel,
) -> CellComparison:
    """Residuals of the target's cells under a pose."""
    cells = null_model.cells
    expected, sd, G, is_known = base.raster.lookup(transform_points(target.samples, T_base_target))
    residual = rotate_vectors(field, T_base_target) - expected
    rows = np.flatnonzero(cells.mean(is_known[:, None].astype(np.float64))[:, 0] > WHOLE)
    sample_chi2 = (residual**2).sum(axis=1) / (base.noise_sd**2 + target.noise_sd**2 + sd**2)
    off = field_variance(G, base.drift.sd**2 + target.drift.sd**2)
    map_variance, drift_variance = cells.mean(np.column_stack([sd**2, off])).T
    return CellComparison(is_known, sample_chi2, rows, cells.mean(residual), map_variance, drift_variance)


def compare_back(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, nulls: NullModels
) -> tuple[NullModel, CellComparison]:
    """Do as `compare_cells` does, from the other side: cells of the base that a pose puts inside the target."""
    T = pose.T_base_target
    expected, sd, G, is_known = target.raster.lookup(transform_points(base.samples, T.inv()))
    _, cell = np.unique(cube_keys(base.samples, nulls.side), return_inverse=True)
    inside = (np.bincount(cell, is_known) / np.bincount(cell) > WHOLE)[cell]
    field, sd = base.sample_field[inside], sd[inside]
    residual = field - rotate_vectors(pose.sensor.correct(expected[inside]), T)
    null_model = nulls.of_base(base.samples[inside], field)
    cells = null_model.cells
    sample_chi2 = (residual**2).sum(axis=1) / (nulls.noise_variance + sd**2)
    off = field_variance(G[inside], base.drift.sd**2 + target.drift.sd**2)
    map_variance, drift_variance = cells.mean(np.column_stack([sd**2, off])).T
    rows = np.arange(len(cells.counts))
    return null_model, CellComparison(is_known, sample_chi2, rows, cells.mean(residual), map_variance, drift_variance)


def agreeing_cells(
    seen: CellComparison, null_model: NullModel, shares: Sequence[float] = UNCHANGED_SHARES
) -> tuple[Indices, float, float]:
    """Cells that the base explains, if something has changed in the others.

    Returns
    -------
    rows : (r,) int array
        The share of cells, those with the smallest residuals, that gives most evidence for the pose.
    log_ratio : float, nats
        Of these cells, minus the penalty.
    price : float, nats
        The penalty for choosing these cells.
    """
    chi2 = (seen.residual**2).sum(axis=1) / (null_model.noise + seen.map_variance)
    ordered, n = seen.rows[np.argsort(chi2[seen.rows], kind="stable")], len(seen.rows)
    best: tuple[Indices, float, float] = (seen.rows, -np.inf, 0.0)
    for share in shares if n else ():
        rows = np.sort(ordered[: max(1, round(share * n))])
        price = float(gammaln(n + 1) - gammaln(len(rows) + 1) - gammaln(n - len(rows) + 1))
        log_ratio, _ = null_model.log_ratio(seen.residual[rows], seen.map_variance[rows], rows)
        if log_ratio - price > best[1]:
            best = rows, log_ratio - price, price
    return best


def _search_price(joint: Matrix | None, sensor_sd: np.ndarray, log_prior: float) -> float:
    """Log of the fraction of all poses (under the prior) and sensors that the estimate's covariance occupies."""
    if joint is None:
        return -np.inf
    scale = np.concatenate([np.ones(6), sensor_sd])
    _, log_det = np.linalg.slogdet(joint / np.outer(scale, scale))
    return float(0.5 * log_det + 3 * np.log(2 * np.pi) + log_prior)
