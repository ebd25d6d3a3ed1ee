# SPDX-License-Identifier: BSD-3-Clause
"""Cells of two surveys: what each says on its own, and how far the other's map explains it under a pose."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import gammaln

from magmatch.estimation.candidate_poses import OUTLIER_SHARE
from magmatch.estimation.cubes import cube_keys
from magmatch.estimation.map_null_model import CellMeans, NullModel, UnrelatedField, average_cells
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.prepared.drift import field_variance
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.refine.refinement import RefinedPose
from magmatch.typing import Indices, Mask, Points, Scalars, Tensors, Vectors


def _shares_left() -> Iterator[float]:
    share = 1.0
    while share >= OUTLIER_SHARE:
        yield share
        share -= OUTLIER_SHARE / 2


# Neighbouring samples share the map's error; a cell mean is never better than this share of the noise variance.
CORRELATED_NOISE_SHARE = 0.1
# Tried shares of cells that have not changed, in steps of half of what may match nothing, and no less than that.
UNCHANGED_SHARES = tuple(_shares_left())


@dataclass(frozen=True, eq=False, slots=True)
class NullModels:
    """Null hypotheses of a pair: what either survey looks like on its own."""

    target: NullModel  # of all its cells
    base: UnrelatedField  # which of its cells lie in the overlap depends on the pose
    base_cubes: Indices  # (n,) ints: cell that each of the base's samples lies in
    side: float  # m: of the cells
    noise_variance: float  # T^2: of one sample of both surveys together

    def of_base(self, positions: Points, field: Vectors) -> NullModel:
        """Give the null model of those samples of the base that a pose puts inside the target."""
        return self.base.over(*_in_cells(positions, field, self.side, self.noise_variance))


def null_models_of(base: PreparedMap, target: PreparedMap) -> NullModels:
    """State the null hypotheses of a pair; the hyperparameters of either field have maximum likelihood."""
    side, noise_variance = common_length(base, target), base.noise_sd**2 + target.noise_sd**2

    of_target, of_base = (
        _in_cells(survey.samples, survey.sample_field, side, noise_variance) for survey in (target, base)
    )
    _, base_cubes = np.unique(cube_keys(base.samples, side), return_inverse=True)
    return NullModels(
        UnrelatedField.most_likely(*of_target, target.correlation_length).over(*of_target),
        UnrelatedField.most_likely(*of_base, base.correlation_length),
        base_cubes,
        side,
        noise_variance,
    )


def _in_cells(
    positions: Points, field: Vectors, side: float, noise_variance: float
) -> tuple[CellMeans, Vectors, Scalars]:
    """Cells of some samples, their mean field, and its noise variance."""
    cells = average_cells(positions, side)
    return cells, cells.mean(field), noise_variance * (1 / cells.counts + CORRELATED_NOISE_SHARE)


@dataclass(frozen=True, eq=False, slots=True)
class CellComparison:
    """Residuals of one survey's samples under the other's map, and their means over the survey's cells."""

    is_known: Mask  # (n,) bool: samples where the map knows the field
    sample_chi2: Scalars  # (n,): squared residual of each sample over its expected variance
    rows: Indices  # (r,) ints: cells that lie in the overlap
    residual: Vectors  # (c, 3), T: mean of each cell
    map_variance: Scalars  # (c,), T^2: of the map
    drift_variance: Scalars  # (c,), T^2: of one component, through the drift that either survey declares

    @classmethod
    def of(
        cls, cells: CellMeans, rows: Indices, residual: Vectors, seen: tuple[Scalars, Tensors, Mask],
        base: PreparedMap, target: PreparedMap,
    ) -> "CellComparison":  # fmt: skip
        """Average the samples' residuals; `seen` is the other map's spread and gradient there, and whether known."""
        sd, gradient, is_known = seen
        sample_chi2 = (residual**2).sum(axis=1) / (base.noise_sd**2 + target.noise_sd**2 + sd**2)
        off = field_variance(gradient, base.drift.sd**2 + target.drift.sd**2)
        map_variance, drift_variance = cells.mean(np.column_stack([sd**2, off])).T
        return cls(is_known, sample_chi2, rows, cells.mean(residual), map_variance, drift_variance)

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
    rows = np.flatnonzero(cells.mean(is_known[:, None].astype(np.float64))[:, 0] == 1.0)
    return CellComparison.of(cells, rows, residual, (sd, G, is_known), base, target)


def compare_back(
    base: PreparedMap, target: PreparedMap, pose: RefinedPose, nulls: NullModels
) -> tuple[NullModel, CellComparison]:
    """Residuals of those of the base's cells that a pose puts inside the target, with their null model."""
    T = pose.T_base_target
    expected, sd, G, is_known = target.raster.lookup(transform_points(base.samples, T.inv()))
    cubes = nulls.base_cubes
    inside = (np.bincount(cubes, is_known) == np.bincount(cubes))[cubes]
    field = base.sample_field[inside]
    residual = field - rotate_vectors(pose.sensor.correct(expected[inside]), T)
    null_model = nulls.of_base(base.samples[inside], field)
    seen, rows = (sd[inside], G[inside], is_known[inside]), np.arange(len(null_model.cells.counts))
    return null_model, CellComparison.of(null_model.cells, rows, residual, seen, base, target)


def agreeing_cells(
    seen: CellComparison, null_model: NullModel, shares: Sequence[float] = UNCHANGED_SHARES
) -> tuple[Indices, float, float]:
    """Cells that the base explains, if something has changed in the others.

    Returns the share of cells, those with the smallest residuals, that gives most evidence for the pose; this
    evidence minus the penalty for choosing these cells; and the penalty, nats.
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
