# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a walk that bends, in a map whose errors are known by its posterior alone.

Where a base passed each place once, no stretch of it can be held out to learn what residuals look like. Its posterior
says which errors a map has beside a single pass: they are large, but smooth, so that the field along a second path
follows from few unknowns. The walk's positions and orientations drift by a random walk of unknown rate. Residuals
``r = b - R^T B_base(T y)`` are therefore normal with the covariance

    R^T K R + D S D^T + n^2 I,

K the posterior's covariance between all bins, D the residuals' slopes with the bending modes (`bending.py`), S their
variances at one rate, n the noise of a bin. Each rate is a model of the pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.bending import Bending, bending_of
from magmatch.estimation.candidate_poses import N_REFINED, pose_inaccuracy
from magmatch.estimation.gauss_newton import perturbed, shortened
from magmatch.estimation.model_prior import EACH_RATE, RATES
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import in_order
from magmatch.estimation.walk import MIN_BINS, Walk
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.estimation.walk_rows import N_COLUMNS, residual_rows
from magmatch.field.values import gradient_of
from magmatch.geometry import rotation_matrix, transform_of
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.weigh.refine_and_weigh_walk import FREE_SDS, LineConfig, LineEvidence
from magmatch.typing import Mask, Matrix, Points, Vector3

# At which of the rates poses are compared first.
MIDDLE = 0.1
# Steps of the pose at each rate, and those before which the covariance is evaluated again, the last evaluation too.
N_STEPS, RENEWED = 5, (0, 2, 5)
# Spread of a common factor on the covariance: none.
EXACT = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class BendingWalk:
    """A walk and the base that it is compared with."""

    base: PreparedMap
    walk: Walk
    length: float  # m: the base's correlation length
    prior: PosePrior
    config: LineConfig
    null: UnrelatedWalk  # its noise is that of a bin, and how all residuals may be larger or smaller than stated
    bending: Bending  # of the walk's bins

    @classmethod
    def of(cls, base: PreparedMap, walk: Walk, length: float, prior: PosePrior, config: LineConfig) -> "BendingWalk":
        """State the walk's null model, with the noise of a bin, and its modes."""
        noise = noise_of_bins(base.noise_sd, length)
        null = UnrelatedWalk(walk, cdist(walk.positions, walk.positions), noise, length)
        return cls(base, walk, length, prior, config, null, bending_of(walk.positions))

    def weigh(self, starts: Sequence[RigidTransform]) -> list[LineEvidence]:
        """Refine poses at one rate, and the best few at each; best first, without those outside the base."""
        coarse = in_order(self._fit(T, MIDDLE) for T in starts)
        others = [rate for rate in RATES if rate != MIDDLE]
        fine = [self._fit(one.T_base_target, rate) for one in coarse[:N_REFINED] for rate in others]
        return in_order([*coarse, *fine])

    @property
    def _center(self) -> Vector3:
        return np.asarray(self.walk.positions.mean(axis=0))

    def _fit(self, start: RigidTransform, rate: float) -> LineEvidence | None:
        """Take Gauss-Newton steps of a pose; the walk's shape is integrated out."""
        R, p = rotation_matrix(start), start.apply(self._center)
        longest = np.repeat(pose_inaccuracy(self.length), 3)
        factor, seen = np.zeros((0, 0)), np.zeros(0, dtype=np.bool_)
        for step in range(N_STEPS + 1):
            known, points, rows, slopes = self._rows(R, p)
            if known.sum() < MIN_BINS:
                return None
            if step in RENEWED or not np.array_equal(known, seen):
                moved = (slopes @ (rate * self.bending.modes[known])).reshape(len(rows), -1)
                factor, seen = np.linalg.cholesky(self._rigid_covariance(R, points) + moved @ moved.T), known
            white = solve_triangular(factor, rows, lower=True, check_finite=False)
            r, J = white[:, 0], white[:, 1:]
            known_before, slope, prior_chi2 = (x[0] for x in self.prior.rows_of_many(R[None], p[None], self._center))
            told = J.T @ J + np.diag((FREE_SDS * longest) ** -2)
            if step < N_STEPS:
                xi = shortened(-np.linalg.solve(told + known_before, J.T @ r + slope), longest)
                R, p = (moved[0] for moved in perturbed(R[None], p[None], xi[None]))
        n_free, chi2 = 3 * int(known.sum()) - 6, float(r @ r)
        covariance = np.linalg.inv(told / max(1.0, chi2 / n_free) + known_before)
        rest = (
            EACH_RATE
            + 0.5 * float(np.linalg.slogdet(2 * np.pi * covariance)[1])
            + float(self.prior.log_densities(known_before[None], np.array([prior_chi2]))[0])
            + float(self.config.log_weight(self.walk.length / self.length, known.mean()))
            - float(np.log(np.diag(factor)).sum())
            - self.null.log_likelihood(known)
        )
        return LineEvidence(
            T_base_target=transform_of(R, p - R @ self._center),
            center=self._center,
            covariance=covariance + rate**2 * self.bending.frame,
            overlap=float(known.mean()),
            log_evidence=rest - 0.5 * chi2,
            attainable=rest - 0.5 * min(chi2, n_free),
            misfit=float(np.sqrt(chi2 / n_free)),
            is_covered=known,
            model=f"drifts by {rate} m per root of a metre",
        )

    def _rows(self, R: Matrix, p: Vector3) -> tuple[Mask, Points, Matrix, np.ndarray]:
        """Bins inside the base (n,): where they are (k, 3), residuals with slopes by the pose (3 k, 7), by moves."""
        y = self.walk.positions - self._center
        _, _, _, known = self.base.raster.lookup(p + y @ R.T)
        y, b = y[known], self.walk.field[known]
        points, told = p + y @ R.T, np.ones((1, len(y)))
        values = self.base.posterior.evaluate(points, order=1)
        rows, slopes = residual_rows(R[None], y[None], b[None], (values.field, gradient_of(values)), told > 0, told)
        return known, points, rows.reshape(3 * len(y), N_COLUMNS), slopes[0]

    def _rigid_covariance(self, R: Matrix, points: Points) -> Matrix:
        """The residuals' covariance without bending, walk's axes: (3 k, 3 k)."""
        n, h = len(points), self.base.field_map.hyperparameters
        C = self.base.field_map.posterior.influence(points) * (h.inflation * h.noise_sd) ** 2
        C = np.einsum("ai,namb,bj->nimj", R, C.reshape(n, 3, n, 3), R, optimize=True).reshape(3 * n, 3 * n)
        return np.asarray(C + self.null.noise.nugget_sd**2 * np.eye(3 * n))


def noise_of_bins(noise_sd: float, length: float) -> PathNoise:
    """Half of the variance of a sample's noise lasts along the path, so that no bin averages it out."""
    nothing = 1e-6 * noise_sd
    return PathNoise(
        misfit_sd=nothing,
        misfit_length=length,
        nugget_sd=float(np.sqrt(0.5)) * noise_sd,
        constant_sd=nothing,
        map_factor=1.0,
        map_length=length,
        attitude_sd=1e-6,
        drift_sd=nothing,
        drift_length=length,
        spread=EXACT,
    )
