# SPDX-License-Identifier: BSD-3-Clause
"""Refine and weigh poses of a walk by generalised least squares, with residuals correlated along the path.

Residuals are taken in the walk's axes, ``r = b - R^T B_base(T y)``, and the pose is perturbed about the walk's
centre c, ``T Exp(xi)``: Jacobian ``[-[b]x + G [y - c]x, -G]``, G the base's gradient in the walk's axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.estimation.candidate_poses import OUTLIER_SHARE, pose_inaccuracy
from magmatch.estimation.gauss_newton import perturbed, shortened
from magmatch.estimation.limits import COARSE_STEPS, FINE_STEPS, N_REFINED
from magmatch.estimation.model_prior import UNEXPLAINED, path_weight
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import FAR2, PosePrior
from magmatch.estimation.posterior import Kind
from magmatch.estimation.walk import MIN_BINS, Walk
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.estimation.walk_rows import isolate, residual_rows, whiten
from magmatch.field.values import gradient_of
from magmatch.geometry import rotation_matrix, transform_of
from magmatch.registration.prepared.inside import spread_inside
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.typing import Covariance6, Indices, Mask, Matrix, Points, Scalars, Tensors, Vector3

# Prior standard deviation of a pose in undetermined directions, in those of the search: far wider.
FREE_SDS = 5.0
# Bins that something disturbs together, at least.
PIECE_BINS = 5


@dataclass(frozen=True, eq=False, slots=True)
class LineEvidence:
    """One pose of a walk at the optimum."""

    kind: ClassVar[Kind] = "walk"

    T_base_target: RigidTransform  # base model frame from the walk's frame
    center: Vector3  # (3,), m: point of the walk about which the covariance is stated, walk's frame
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)`` about the centre; rotation first (rad, m), walk's axes
    overlap: float  # share of the bins inside the base map
    # nats: ``log p(b | pose) - log p(b | unrelated) + 1/2 ln det 2 pi C + log prior``, minus the penalty for the path
    # outside the map
    log_evidence: float
    attainable: float  # nats: the same, if the residuals were no larger than expected
    misfit: float  # normalised rms residual (1 when the covariance explains everything)
    is_covered: Mask  # (n,) bool: bins inside the base map
    model: str = "drifts as the base's own stretches do"
    drift: Covariance6 | None = None  # what the walk's bending along its path adds to the covariance

    @property
    def bends(self) -> bool:
        """Whether the walk bends along its path."""
        return self.drift is not None

    @property
    def is_explained(self) -> bool:
        """Whether the pose is likelier than none, and its residuals are no larger than expected."""
        return self.log_evidence > 0 and self.misfit <= 1


def weigh_walk(
    base: PreparedMap,
    walk: Walk,
    starts: Sequence[RigidTransform],
    noise: PathNoise,
    prior: PosePrior,
    bending: np.ndarray | None = None,
    null: UnrelatedWalk | None = None,
) -> list[LineEvidence]:
    """Refine poses of a walk, from starts between its frame and the base's, and order them by evidence, best first.

    ``bending`` (n, 6, m): how m independent errors of unit variance
    turn (rad) and shift (m) each bin of a walk whose shape is known by dead reckoning alone, about its own place,
    walk's axes; takes the place of the noise's drift. ``null``: the walk's null model, if it is known; else any mean
    of its field is as likely.
    """
    if not starts or len(walk) < MIN_BINS:
        return []
    squares = _LeastSquares(base, walk, noise, prior, walk.positions.mean(axis=0), bending)
    null = null or UnrelatedWalk(walk, noise, base.correlation_length)
    R = np.stack([rotation_matrix(T) for T in starts])
    p = np.stack([T.apply(squares.center) for T in starts])
    coarse = _covered(squares.run(R, p, np.ones((len(R), len(walk))), COARSE_STEPS, is_full=False))
    if not len(coarse.chi2):
        return []
    roughly = _weigh(coarse, squares, null)
    order = np.argsort([-e.log_evidence for e in roughly], kind="stable")
    best = coarse.rows(order[:N_REFINED])
    settled = squares.run(best.rotations, best.centers, _strained(best), FINE_STEPS, is_full=False)
    fine = squares.run(settled.rotations, settled.centers, _strained(settled), FINE_STEPS, is_full=True)
    weighed = _weigh(_covered(fine), squares, null)
    weighed += [roughly[k] for k in order[N_REFINED:]]
    return sorted(weighed, key=lambda e: -e.log_evidence)


def inside_base(prior: PosePrior, base: PreparedMap, walk: Walk) -> PosePrior:
    """Spread a prior over poses that put a walk inside a base, as they are weighed."""
    path = walk.length / base.correlation_length
    return spread_inside(prior, base.raster, walk.positions, lambda share: path_weight(path, share))


def _covered(fits: "_Fits") -> "_Fits":
    """Select poses that put enough of the walk inside the base map."""
    return fits.rows(np.flatnonzero(fits.known.sum(axis=1) >= MIN_BINS))


@dataclass(frozen=True, eq=False, slots=True)
class _Fits:
    """Several poses at once, each where its least squares stands."""

    rotations: Tensors  # (h, 3, 3), base from walk
    centers: Points  # (h, 3), m, where each pose puts the walk's centre, base model frame
    known: Matrix  # (h, n) bool
    strain: Matrix  # (h, n), what each bin's standard deviation is multiplied with
    normalised: Matrix  # (h, n), squared residual of each bin over its expected value
    information: Matrix  # (h, 6, 6)
    chi2: Scalars
    half_log_det: Scalars
    prior_information: Matrix  # (h, 6, 6)
    prior_chi2: Scalars

    def rows(self, chosen: Indices) -> "_Fits":
        return _Fits(*(getattr(self, f.name)[chosen] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class _LeastSquares:
    """Gauss-Newton of many poses at once; bins outside the base map are kept but say nothing."""

    base: PreparedMap
    walk: Walk
    noise: PathNoise
    prior: PosePrior
    center: Vector3
    bending: np.ndarray | None = None

    def run(self, R: Tensors, p: Points, strain: Matrix, n_steps: int, *, is_full: bool) -> _Fits:
        """Take steps; the last evaluation only states chi^2 and information.

        In full, the walk's shape is fitted too: the field is not linear over as far as odometry may bend it.
        """
        errors = np.zeros((len(R), 0 if self.bending is None else self.bending.shape[2]))
        for _ in range(n_steps):
            fits, v, errors_after = self._evaluate(R, p, errors, strain, is_full=is_full)
            xi = -np.linalg.solve(fits.information, v[:, :, None])[:, :, 0]
            xi = shortened(xi, self.longest)
            R, p = perturbed(R, p, xi)
            if is_full and self.bending is not None:
                errors = errors_after(xi)
        return self._evaluate(R, p, errors, strain, is_full=is_full)[0]

    def _evaluate(
        self, R: Tensors, p: Points, errors: Matrix, strain: Matrix, *, is_full: bool
    ) -> tuple[_Fits, Matrix, Callable[[Matrix], Matrix]]:
        """Give the residuals of the poses, the gradient of half their chi^2, and the errors of shape after a step xi.

        The walk is bent by ``errors`` (h, m), in their standard deviations; all m are integrated out from there.
        """
        n_poses, n = len(R), len(self.walk)
        y, b = self._bent(errors)
        points = (p[:, None] + y @ np.swapaxes(R, 1, 2)).reshape(-1, 3)
        _, sd, _, is_known = self.base.raster.lookup(points)
        values = self.base.posterior.evaluate(points, order=1)
        known, sd = is_known.reshape(n_poses, n), sd.reshape(n_poses, n)
        # Where something moved since, residuals of a whole piece are larger by a common factor.
        rows, slopes = residual_rows(R, y, b, (values.field, gradient_of(values)), known, strain)
        moved = None if self.bending is None else slopes @ self.bending
        if moved is not None and errors.any():
            # What the residuals would be if the walk were not bent, by their slopes where it is.
            bent = moved.reshape(n_poses, 3 * n, -1) @ errors[:, :, None]
            rows[..., 0] += bent.reshape(n_poses, n, 3) * (known / strain)[..., None]
        C = (self._full_covariance if is_full else self._alike_covariance)(slopes[..., 3:], moved, sd, known)
        C = isolate(C, known)
        normalised = (rows[..., 0] ** 2).sum(axis=2) * strain**2 / _expected_squares(C, n)
        white, half_log_det, L = _whiten(C, rows)
        half_log_det = half_log_det + 3 * (np.log(strain) * known).sum(axis=1)
        products = np.swapaxes(white, 1, 2) @ white
        chi2, v = products[:, 0, 0], products[:, 1:, 0]
        information = products[:, 1:, 1:] + np.diag((FREE_SDS * self.longest) ** -2)
        prior_information, slope, prior_chi2 = self.prior.rows_of_many(R, p, self.center)
        information, v = information + prior_information, v + slope

        def errors_after(xi: Matrix) -> Matrix:
            assert moved is not None
            left = white[..., 0] + np.einsum("hki,hi->hk", white[..., 1:], xi)
            return np.asarray(np.einsum("hkm,hk->hm", moved.reshape(n_poses, 3 * n, -1), whiten(L, left, again=True)))

        fits = _Fits(R, p, known, strain, normalised, information, chi2, half_log_det, prior_information, prior_chi2)
        return fits, v, errors_after

    def _bent(self, errors: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Bins about the centre, and their field, of a walk whose shape has some errors: (h, n, 3) each."""
        h = len(errors)
        y, b = (np.repeat(x[None], h, axis=0) for x in (self.walk.positions - self.center, self.walk.field))
        if self.bending is None or not errors.any():
            return y, b
        off = np.einsum("nim,hm->hni", self.bending, errors)
        turns = Rotation.from_rotvec(off[..., :3].reshape(-1, 3))
        return y + off[..., 3:], turns.apply(b.reshape(-1, 3)).reshape(b.shape)

    def pose(self, R: Matrix, moved_center: Vector3) -> RigidTransform:
        """Transform that turns by R and puts the walk's centre somewhere."""
        return transform_of(R, moved_center - R @ self.center)

    def _alike_covariance(self, G: Tensors, moved: np.ndarray | None, sd: Matrix, known: Matrix) -> Matrix:
        """Components taken alike, (h, n, n): one small factor serves all; the frame's moves count on average."""
        if moved is not None:
            moved = moved.reshape(*known.shape, -1)
            C = np.asarray(moved @ np.swapaxes(moved, 1, 2) / 3)
        else:
            moves2 = (self.noise.drift_sd**2 / 3) * (G**2).sum(axis=(1, 2, 3)) / np.maximum(known.sum(axis=1), 1)
            moves2 = moves2 + self.noise.attitude_sd**2 * float((self.walk.field**2).sum(axis=1).mean()) * 2 / 3
            C = moves2[:, None, None] * np.exp(-self.walk.distance / self.noise.drift_length)
        return np.asarray(C + self.noise.isotropic(self.walk.distance, sd))

    def _full_covariance(self, G: Tensors, moved: np.ndarray | None, sd: Matrix, known: Matrix) -> Matrix:
        """Components coupled by frames that drift and turn, (h, 3 n, 3 n)."""
        if moved is None:
            field = np.broadcast_to(self.walk.field, (*known.shape, 3))
            return self.noise.full(self.walk.distance, sd, G, field)
        moved = moved.reshape(len(moved), -1, moved.shape[-1])
        return self.noise.with_isotropic(moved @ np.swapaxes(moved, 1, 2), self.walk.distance, sd)

    @property
    def longest(self) -> np.ndarray:
        """Longest step, (6,): as far as a start may be off."""
        return np.repeat(pose_inaccuracy(self.base.correlation_length), 3)


def _weigh(fits: _Fits, squares: _LeastSquares, null: UnrelatedWalk) -> list[LineEvidence]:
    """Evidence of each pose; the covariance's common factor is the most likely one under its learned spread."""
    if not len(fits.chi2):
        return []
    n_known = fits.known.sum(axis=1)
    n_free, path = 3 * n_known - 6, squares.walk.length / squares.base.correlation_length
    inflation, log_likelihood = squares.noise.factor(fits.chi2, n_free)
    # A walk that fits better than a guess expects may still share its frame's errors.
    least = 0.0 if squares.noise.is_learned else 1.0
    # The factor is on what residuals tell.
    told = (fits.information - fits.prior_information) / np.maximum(inflation, least)[:, None, None]
    covariance = np.linalg.inv(told + fits.prior_information)
    covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    log_evidence = (
        log_likelihood  # with the pose integrated out at each factor: so many residuals fewer
        - fits.half_log_det
        - np.array([null.log_likelihood(known) for known in fits.known])
        - 0.5 * np.linalg.slogdet(fits.information / (2 * np.pi))[1]
        + squares.prior.log_densities(fits.prior_information, fits.prior_chi2)
        + path_weight(path, fits.known.mean(axis=1))
        + UNEXPLAINED * path * (fits.strain > 1).mean(axis=1)
    )
    attainable = log_evidence + np.maximum(squares.noise.factor(n_free, n_free)[1] - log_likelihood, 0.0)
    misfit = np.sqrt(fits.chi2 / n_free)
    return [
        LineEvidence(
            T_base_target=squares.pose(fits.rotations[k], fits.centers[k]),
            center=squares.center,
            covariance=covariance[k],
            overlap=float(fits.known[k].mean()),
            log_evidence=float(log_evidence[k]),
            attainable=float(attainable[k]),
            misfit=float(misfit[k]),
            is_covered=fits.known[k],
        )
        for k in range(len(fits.chi2))
    ]


def _whiten(C: Matrix, rows: Matrix) -> tuple[Matrix, Scalars, Matrix]:
    """Whiten rows (h, n, 3, k) by covariances of all components (h, 3 n, 3 n) or of one for all (h, n, n).

    Returns the whitened rows (h, 3 n, k), half the log-determinants (h,), and the factors of the covariances.
    """
    h, n, _, k = rows.shape
    L = np.linalg.cholesky(C)
    white = whiten(L, rows.reshape(h, C.shape[1], -1)).reshape(h, 3 * n, k)
    return white, 3 * n // C.shape[1] * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1), L


def _expected_squares(C: Matrix, n: int) -> Matrix:
    """Give the expected square of n bins' residual vectors, by covariances as `_whiten` takes them: (h, n)."""
    h, n_alike = len(C), 3 * n // C.shape[1]
    return np.asarray(n_alike * np.diagonal(C, axis1=1, axis2=2).reshape(h, n, -1).sum(axis=2))


def _strained(fits: _Fits) -> Matrix:
    """Factor on each bin's standard deviation where a piece of the path disagrees far more than the rest."""
    # Residuals of a piece are correlated: it counts as one vector. It is no longer than the path.
    window = np.ones(min(PIECE_BINS, fits.known.shape[1]))
    counts = np.maximum([np.convolve(k, window, mode="same") for k in fits.known.astype(float)], 1.0)
    power = np.stack([np.convolve(x, window, mode="same") for x in fits.normalised * fits.known]) / counts
    is_strained = (power > FAR2 / 3) & fits.known
    # A pose that disagrees nearly everywhere is wrong rather than disturbed.
    is_disturbed = is_strained.sum(axis=1) <= OUTLIER_SHARE * fits.known.sum(axis=1)
    return np.sqrt(np.where(is_strained & is_disturbed[:, None], power, 1.0))
