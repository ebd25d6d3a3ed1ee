# SPDX-License-Identifier: BSD-3-Clause
"""Evidence for a pose: cells of the target that agree or disagree with the base's field."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.model_prior import overlap_weight
from magmatch.estimation.pose_prior import FAR2, PosePrior
from magmatch.estimation.posterior import Kind
from magmatch.registration.prepared.prepared_map import MEDIAN_CHI2_3, PreparedMap
from magmatch.registration.refine.refinement import RefinedPose
from magmatch.registration.weigh.cells import NullModels, compare_back, compare_cells
from magmatch.registration.weigh.covariance import joint_covariance
from magmatch.typing import Indices, Matrix, Vector3, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class PoseEvidence:
    """Statistics of one refined pose, weighed by cells."""

    kind: ClassVar[Kind] = "map"
    drift: ClassVar[None] = None  # only the halves of a map show that it bends

    pose: RefinedPose
    # (6, 6) or None: about the pose's centre, target's model axes, from the comparison of the fields alone
    covariance: Matrix | None
    overlap: float  # fraction of the target's samples where the base knows the field
    n_informative: int  # cells in the overlap whose field differs from the target's mean field
    n_good: int  # and those of them that agree with the base
    # nats: ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C + log prior``: the log odds of this pose,
    # with the penalty for the search over all poses
    log_evidence: float
    attainable: float  # nats: the same, if the base explained all cells perfectly
    price: float  # nats: the penalty alone, with the prior of the model
    residual: float  # robust normalised rms residual over the overlap
    # Normalised rms of the cells' mean residuals, the larger of both surveys': about 1 when noise and the other map's
    # spread explain them
    misfit: float
    # What was estimated to have changed; all figures but `overlap` then refer to the cells that it leaves
    change: "Change | None" = None
    model: str = "rigid"

    @property
    def T_base_target(self) -> RigidTransform:
        """Model frame to model frame."""
        return self.pose.T_base_target

    @property
    def center(self) -> Vector3:
        """Point about which the covariance is stated, m, target's model frame."""
        return self.pose.center

    @property
    def is_beside_change(self) -> bool:
        """Whether a change of the field was estimated with the pose."""
        return self.change is not None

    @property
    def unchanged(self) -> float:
        """Share of the cells in the overlap that are used; the others have changed."""
        return 1.0 if self.change is None else self.change.unchanged

    @property
    def good_share(self) -> float:
        """Share of the informative cells that agree."""
        return self.n_good / self.n_informative if self.n_informative else 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """The change of the field between two surveys, under one pose."""

    # (n, 3), T: the target's field minus the base's at the target's samples, target's model frame; None where nothing
    # is said of what changed, but that it is in the other cells
    field: Vectors | None
    rows: Indices  # (r,) ints: cells that are used; in the others too much has changed
    unchanged: float  # these as a share of the overlap's cells
    # nats: log-likelihood ratio of 'the base with this change' to 'an independent field' for these cells, minus the
    # penalty for choosing them
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

    The target's cells are compared with the base's map, and the base's cells with the target's map. Both estimate one
    number, ``log p(both | pose) / p(base) p(target)``; their mean is the better estimate. With a change, only the
    target's cells are compared: it was estimated from them.
    """
    field = pose.sensor.correct(target.sample_field)
    if change is not None and change.field is not None:
        field = field - change.field
    null_model = nulls.target
    seen = compare_cells(base, target, pose.T_base_target, field, null_model)
    # From the fields alone: correlated residuals would outweigh the prior in the curvature.
    alone = replace(pose, prior_information=np.zeros((6, 6)))
    joint = joint_covariance(alone, 2 * nulls.side)
    covariance = None if joint is None else joint[:6, :6]
    overlap = float(seen.is_known.mean())
    if not len(seen.rows):
        nothing = (0, 0, -np.inf, -np.inf, -np.inf, np.inf, np.inf)
        return PoseEvidence(pose, covariance, overlap, *nothing, model=_model(pose, change))

    rows = seen.rows if change is None else change.rows
    sides = [(null_model, seen, rows)]
    if change is None:
        of_base, back = compare_back(base, target, pose, nulls)
        sides += [(of_base, back, back.rows)] if len(back.rows) else []
    ratios = [null.log_ratio(side.residual[r], side.map_variance[r], r) for null, side, r in sides]
    log_ratio, attainable = np.mean(ratios, axis=0)
    if change is not None:
        log_ratio = change.log_ratio
    # An implausible difference between the sensors is evidence against the pose.
    log_ratio -= 0.5 * float(((pose.sensor.parameters / pose.sensor_sd) ** 2).sum())
    r2, variance = (seen.residual[rows] ** 2).sum(axis=1), null_model.noise[rows] + seen.map_variance[rows]
    n2 = ((null_model.field[rows] - null_model.field.mean(axis=0)) ** 2).sum(axis=1)
    # The variance stated by noise and map, or that of the residuals: their sum would count one error twice.
    V = np.maximum(variance, np.median(r2) / MEDIAN_CHI2_3)
    is_informative = n2 > FAR2 * V
    sample_chi2 = seen.sample_chi2[seen.is_known & (True if change is None else null_model.cells.holds(rows))]
    log_prior = prior.log_density(pose.T_base_target, pose.center, covariance)
    price = _search_price(joint, pose.sensor_sd, log_prior) + float(overlap_weight(overlap)) + pose.log_prior
    return PoseEvidence(
        pose,
        covariance,
        overlap,
        int(is_informative.sum()),
        int((is_informative & (r2 < FAR2 * V)).sum()),
        float(log_ratio + price),
        float(attainable + price),
        price,
        float(np.sqrt(np.median(sample_chi2) / MEDIAN_CHI2_3)),
        max(side.misfit(null, r) for null, side, r in sides),
        change,
        _model(pose, change),
    )


def _model(pose: RefinedPose, change: Change | None) -> str:
    sensors = f", sensors {pose.log_prior:g}" if pose.log_prior else ""
    if change is None:
        return f"rigid{sensors}"
    return f"rigid, {'without changed cells' if change.field is None else 'changed'}{sensors}"


def _search_price(joint: Matrix | None, sensor_sd: np.ndarray, log_prior: float) -> float:
    """Log of the fraction of all poses (under the prior) and sensors that the estimate's covariance occupies."""
    if joint is None:
        return -np.inf
    scale = np.concatenate([np.ones(6), sensor_sd])
    _, log_det = np.linalg.slogdet(joint / np.outer(scale, scale))
    return float(0.5 * log_det + 3 * np.log(2 * np.pi) + log_prior)
