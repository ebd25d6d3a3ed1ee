# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a walk that bends, in a map whose errors are known by its posterior alone.

Where a base passed each place once, no stretch of it can be held out to learn what residuals look like. Its posterior
says which errors a map has beside a single pass: they are large, but smooth, so that the field along a second path
follows from few unknowns. The walk's positions and orientations drift by a random walk of unknown rate. Residuals
``r = b - R^T B_base(T y)`` are therefore normal with the covariance

    R^T K R + D S D^T + n^2 I,

K the posterior's covariance between all bins, D the residuals' slopes with the bending modes, S their
variances at one rate, n the noise of a bin. Each rate is a model of the pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular, svd
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.candidate_poses import pose_inaccuracy
from magmatch.estimation.gauss_newton import is_close, perturbed, shortened
from magmatch.estimation.limits import MOST_STEPS, N_MODES, N_REFINED
from magmatch.estimation.model_prior import EACH_RATE, RATES
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import in_order
from magmatch.estimation.walk import MIN_BINS, Walk
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.estimation.walk_rows import residual_rows
from magmatch.field.values import gradient_of
from magmatch.geometry import rotation_matrix, skew, transform_of
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.weigh.refine_and_weigh_walk import FREE_SDS, LineConfig, LineEvidence
from magmatch.typing import Covariance6, Mask, Matrix, Points, Scalars, Vector3

# Turn that comes with a shift of one metre, rad/m: what dead reckoning loses of both (0.6 deg with 10 cm).
TURN_PER_SHIFT = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Bending:
    """Drift of two surveys at a rate of 1 m per sqrt(m), about its mean along the path, in two parts."""

    modes: np.ndarray  # (n, 6, m): turn (rad) and shift (m) of each point by independent errors of unit variance
    # (6, 6): covariance of the rigid motion about the path's centre that best follows the drift, rotation first: an
    # error of the frame, which no residual shows
    frame: Covariance6


class _Comparison(NamedTuple):
    """A walk and its base, compared at a pose."""

    R: Matrix  # (3, 3), base from walk
    p: Vector3  # m, where the walk's centre lies in the base
    known: Mask  # (n,), bins inside the base
    chi2: float
    occam: float  # nats: what else of the pose's probability differs from pose to pose
    told: Matrix  # (6, 6): information of the residuals
    prior: Matrix  # (6, 6): information of the pose's prior
    step: Scalars  # (6,): what Gauss-Newton proposes

    @property
    def log_probability(self) -> float:
        """The pose's log probability up to a constant, nats."""
        return self.occam - 0.5 * self.chi2

    @property
    def information(self) -> Matrix:
        """What is known of the pose, (6, 6)."""
        return np.asarray(self.told + self.prior)


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
        """Refine poses at one rate, and the best few at each; best first, without those outside the base.

        The map's errors differ from pose to pose over a correlation length. A pose that is refined moves by less, so
        they are evaluated where it starts, and for the best few anew where they stand.
        """
        middle = RATES[len(RATES) // 2]
        coarse = in_order(self._fit(T, middle, self._map_errors(T)) for T in starts)
        fine: list[LineEvidence | None] = []
        for one in coarse[:N_REFINED]:
            errors = self._map_errors(one.T_base_target)
            fine += [self._fit(one.T_base_target, rate, errors) for rate in RATES]
        return in_order([*fine, *coarse[N_REFINED:]])

    @property
    def _center(self) -> Vector3:
        return np.asarray(self.walk.positions.mean(axis=0))

    def _fit(self, start: RigidTransform, rate: float, errors: np.ndarray) -> LineEvidence | None:
        """Refine a pose, given the map's errors there; the walk's shape is integrated out.

        A step that makes the pose less probable, as where bins leave the base, is halved.
        """
        R, p = rotation_matrix(start), start.apply(self._center)
        best = self._compare(R, p, rate, errors)
        if best is None:
            return None
        xi = best.step
        for _ in range(MOST_STEPS):
            R, p = (moved[0] for moved in perturbed(best.R[None], best.p[None], xi[None]))
            found = self._compare(R, p, rate, errors)
            if found is not None and found.log_probability > best.log_probability:
                best, xi = found, found.step
            else:
                xi = xi / 2
            if is_close(xi, best.information):
                break
        return self._evidence(best, rate)

    def _compare(self, R: Matrix, p: Vector3, rate: float, errors: np.ndarray) -> "_Comparison | None":
        """Compare the walk with the base at a pose; None where too little of it lies inside."""
        known, rows, slopes = self._rows(R, p)
        if known.sum() < MIN_BINS:
            return None
        moved = (slopes @ (rate * self.bending.modes[known])).reshape(len(rows), -1)
        factor = np.linalg.cholesky(self._rigid_covariance(R, errors, known) + moved @ moved.T)
        white = solve_triangular(factor, rows, lower=True, check_finite=False)
        r, J = white[:, 0], white[:, 1:]
        prior, slope, prior_chi2 = (x[0] for x in self.prior.rows_of_many(R[None], p[None], self._center))
        longest = np.repeat(pose_inaccuracy(self.length), 3)
        told = J.T @ J + np.diag((FREE_SDS * longest) ** -2)
        occam = (
            float(self.prior.log_densities(prior[None], np.array([prior_chi2]))[0])
            + float(self.config.log_weight(self.walk.length / self.length, known.mean()))
            - float(np.log(np.diag(factor)).sum())
            - self.null.log_likelihood(known)
        )
        step = shortened(-np.linalg.solve(told + prior, J.T @ r + slope), longest)
        return _Comparison(R, p, known, float(r @ r), occam, told, prior, step)

    def _evidence(self, found: "_Comparison", rate: float) -> LineEvidence:
        """Integrate the pose out."""
        n_free = 3 * int(found.known.sum()) - 6
        covariance = np.linalg.inv(found.told / max(1.0, found.chi2 / n_free) + found.prior)
        rest = EACH_RATE + 0.5 * float(np.linalg.slogdet(2 * np.pi * covariance)[1]) + found.occam
        return LineEvidence(
            T_base_target=transform_of(found.R, found.p - found.R @ self._center),
            center=self._center,
            covariance=covariance + rate**2 * self.bending.frame,
            overlap=float(found.known.mean()),
            log_evidence=rest - 0.5 * found.chi2,
            attainable=rest - 0.5 * min(found.chi2, n_free),
            misfit=float(np.sqrt(found.chi2 / n_free)),
            is_covered=found.known,
            model=f"drifts by {rate} m per root of a metre",
        )

    def _rows(self, R: Matrix, p: Vector3) -> tuple[Mask, Matrix, np.ndarray]:
        """Bins inside the base (n,), their residuals with slopes by the pose (3 k, 7), and slopes by moves."""
        y = self.walk.positions - self._center
        _, _, _, known = self.base.raster.lookup(p + y @ R.T)
        y, b = y[known], self.walk.field[known]
        points, told = p + y @ R.T, np.ones((1, len(y)))
        values = self.base.posterior.evaluate(points, order=1)
        rows, slopes = residual_rows(R[None], y[None], b[None], (values.field, gradient_of(values)), told > 0, told)
        return known, rows.reshape(3 * len(y), rows.shape[-1]), slopes[0]

    def _map_errors(self, T: RigidTransform) -> np.ndarray:
        """Covariance of the map's errors between all bins, base model axes: (n, 3, n, 3), T^2."""
        points, h = T.apply(self.walk.positions), self.base.field_map.hyperparameters
        C = self.base.field_map.posterior.influence(points) * (h.inflation * h.noise_sd) ** 2
        return np.asarray(C.reshape(len(points), 3, len(points), 3))

    def _rigid_covariance(self, R: Matrix, errors: np.ndarray, known: Mask) -> Matrix:
        """The residuals' covariance without bending, of known bins, walk's axes: (3 k, 3 k)."""
        C = np.einsum("ai,namb,bj->nimj", R, errors[known][:, :, known], R, optimize=True)
        noise = self.null.noise.nugget_sd**2 * np.eye(3 * known.sum())
        return np.asarray(C.reshape(noise.shape) + noise)


def noise_of_bins(noise_sd: float, length: float) -> PathNoise:
    """Half of the variance of a sample's noise lasts along the path, so that no bin averages it out."""
    noise = PathNoise.guess(length, 0.0, float(np.sqrt(0.5)) * noise_sd, 0.0)
    # All else is known: the map's errors, the bending.
    return replace(noise, attitude_sd=0.0, drift_sd=0.0, spread=0.0)


def bending_of(positions: Points) -> Bending:
    """Random walks of position and of orientation, which carries all that follows around, of points on a path."""
    n = len(positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    middles = (positions[1:] + positions[:-1]) / 2
    follows = (np.arange(n - 1)[None] < np.arange(n)[:, None]) * np.sqrt(steps)
    arms = skew((positions[:, None] - middles[None]).reshape(-1, 3)).reshape(n, n - 1, 3, 3)
    columns = []
    for e in np.eye(3):
        carried = -arms @ e
        columns.append(np.concatenate([np.broadcast_to(e, carried.shape), carried], axis=2) * TURN_PER_SHIFT)
        columns.append(np.broadcast_to(np.concatenate([np.zeros(3), e]), (n, n - 1, 6)))
    loads = np.moveaxis(np.concatenate([follows[:, :, None] * column for column in columns], axis=1), 1, 2)
    # Base and target drift alike.
    flat = np.sqrt(2) * (loads - loads.mean(axis=0)).reshape(6 * n, -1)
    rigid = _rigid_motions(positions)
    followed = np.linalg.lstsq(rigid, flat, rcond=None)[0]
    modes, strengths, _ = svd(flat - rigid @ followed, full_matrices=False, check_finite=False)
    kept = (modes[:, :N_MODES] * strengths[:N_MODES]).reshape(n, 6, -1)
    return Bending(np.asarray(kept), np.asarray(followed @ followed.T))


def _rigid_motions(positions: Points) -> Matrix:
    """Give the effect of a turn about the path's centre and a shift on turns and shifts of its points: (6 n, 6)."""
    lever = -skew(positions - positions.mean(axis=0))
    eye = np.broadcast_to(np.eye(3), lever.shape)
    rows = np.concatenate([np.concatenate([eye, 0 * eye], axis=2), np.concatenate([lever, eye], axis=2)], axis=1)
    return np.asarray(rows.reshape(6 * len(positions), 6))
