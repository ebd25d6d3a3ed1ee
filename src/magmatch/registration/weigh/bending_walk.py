# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a walk that bends along all of its path.

A walk's positions and orientations drift by random walks of unknown rate. Residuals ``r = b - R^T B_base(T y)`` are
therefore normal with the covariance

    k (C + r^2 G S G^T),

C the covariance of a walk that does not bend, G the residuals' slopes with the bins' turns and shifts, S the
covariance of these at a rate of one, r the rate, k an unknown common factor. Where the base's own stretches could be
held out, C is what they show of walks in this place, their own drift included. Where a base passed each place once,
its posterior says which errors a map has beside a single pass: they are large, but smooth, so that the field along a
second path follows from few unknowns. Then ``C = R^T K R + n^2 I``, K the posterior's covariance between all bins, n
the noise of a bin. The field is not linear over as far as a walk may drift, so its shape is fitted with the pose.
Each rate, with each way to turn, is a model of the pose. The null model has the walk's turns, too: they change its
field wherever it is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.estimation.candidate_poses import pose_inaccuracy
from magmatch.estimation.gauss_newton import is_close, perturbed, shortened
from magmatch.estimation.limits import CLEAR, COARSE_STEPS, MOST_STEPS, N_REFINED
from magmatch.estimation.model_prior import EACH_DRIFT, RATES, TURNS, path_weight
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import RARE, PosePrior
from magmatch.estimation.posterior import distinct, in_order, needed_evidence
from magmatch.estimation.walk import MIN_BINS, Walk
from magmatch.estimation.walk_null_model import UnrelatedWalk
from magmatch.estimation.walk_rows import residual_rows
from magmatch.field.values import gradient_of
from magmatch.geometry import rotation_matrix, transform_of
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.weigh.bending import WalkDrift, bending_of
from magmatch.registration.weigh.refine_and_weigh_walk import FREE_SDS, LineEvidence
from magmatch.typing import Mask, Matrix, Scalars, Vector3


class _Comparison(NamedTuple):
    """A walk and its base, compared at a pose."""

    R: Matrix  # (3, 3), base from walk
    p: Vector3  # m, where the walk's centre lies in the base
    known: Mask  # (n,), bins inside the base
    chi2: float
    fit: float  # nats: log likelihood of the residuals, their covariance's common factor integrated out
    occam: float  # nats: what else of the pose's probability differs from pose to pose
    told: Matrix  # (6, 6): information of the residuals
    prior: Matrix  # (6, 6): information of the pose's prior
    step: Scalars  # (6,): what Gauss-Newton proposes
    bent: Matrix  # (n, 6): turns (rad) and shifts (m) of the bins by which the walk is bent here
    most_likely: np.ndarray  # (n, 6, 7): the same as they are most likely, at this pose and its slopes with the pose

    def bent_after(self, xi: Scalars, share: float) -> Matrix:
        """Bend the walk by a share of what is most likely after a step of the pose."""
        return np.asarray(self.bent + share * (self.most_likely @ [1.0, *xi] - self.bent))

    @property
    def log_probability(self) -> float:
        """The pose's log probability up to a constant, nats."""
        return self.occam + self.fit

    @property
    def information(self) -> Matrix:
        """What is known of the pose, (6, 6)."""
        return np.asarray(self.told + self.prior)


@dataclass(frozen=True, eq=False, slots=True)
class BendingWalk:
    """A walk and the base that it is compared with."""

    base: PreparedMap
    walk: Walk
    prior: PosePrior
    null: UnrelatedWalk  # its noise says how all residuals may be larger or smaller than stated
    turned_null: UnrelatedWalk  # the same, with the walk's turns: more work, so of final poses alone
    drifts: tuple[tuple[WalkDrift, ...], ...]  # tried for each of `TURNS`, the largest first
    share: float  # prior probability of these; the drift of the base's own stretches has the rest

    @classmethod
    def of(
        cls, base: PreparedMap, walk: Walk, noise: PathNoise, prior: PosePrior, *, is_rough: bool = False
    ) -> "BendingWalk":
        """State how the walk may bend beyond what the base's own stretches show, and its null models.

        A rough statement turns as dead reckoning alone, and has no turns in its null model: without them poses have
        more evidence, or less by ``ln 2`` at most.
        """
        bendings = [bending_of(walk.positions, turns) for turns in TURNS[: 1 if is_rough else None]]
        drifts = [[WalkDrift(rate, one) for rate in reversed(one.turns.rates)] for one in bendings]
        n_drifts = sum(map(len, drifts))
        if noise.is_learned:
            own = max(noise.drift_rate, RATES[0])
            drifts = [[one for one in some if one.rate > own] for some in drifts]
        else:
            noise = noise_of_bins(base.noise_sd, base.correlation_length)
        null = UnrelatedWalk(walk, noise, base.correlation_length)
        kept = tuple(tuple(some) for some in drifts)
        turned = [
            one.rate**2 * one.bending.turned(walk.field) for some in drifts for one in some[::-1] if not is_rough
        ]
        with_turns = replace(null, turned=np.stack(turned)) if turned else null
        return cls(base, walk, prior, null, with_turns, kept, sum(map(len, kept)) / n_drifts)

    def weigh(self, likely: Sequence[LineEvidence]) -> list[LineEvidence]:
        """Weigh poses at each drift, beside those at the drift of the base's own stretches; best first."""
        found = self.at_each_drift([one.T_base_target for one in likely])
        return in_order([*map(self._beside_drifts, likely), *found]) if self.null.noise.is_learned else found

    def _beside_drifts(self, pose: LineEvidence) -> LineEvidence:
        """State the evidence of a pose at the base's own drift by the prior and the null model of all drifts."""
        more = float(np.log1p(-self.share))
        more += self.null.log_likelihood(pose.is_covered) - self.turned_null.log_likelihood(pose.is_covered)
        return replace(pose, log_evidence=pose.log_evidence + more, attainable=pose.attainable + more)

    def at_each_drift(self, starts: Sequence[RigidTransform]) -> list[LineEvidence]:
        """Refine poses at one drift, and the best few at each; best first, without those outside the base.

        The map's errors differ from pose to pose over a correlation length. A pose that is refined moves by less, so
        they are evaluated where it starts, and for the best few anew where they stand.
        """
        coarse = self.at_one_drift(starts)
        some = [one for one in coarse[:N_REFINED] if one.log_evidence > coarse[0].log_evidence - CLEAR]
        fine: list[LineEvidence | None] = []
        for one in some:
            errors = self._map_errors(one.T_base_target)
            for drifts in self.drifts:
                found: LineEvidence | None = one
                # A walk that bends less has the narrower optimum.
                for drift in drifts:
                    found = self._fit((found or one).T_base_target, drift, errors)
                    fine.append(found)
        return in_order([*fine, *coarse[len(some) :]])

    def distinct(self, found: Iterable[LineEvidence]) -> list[LineEvidence]:
        """Poses that refinements from elsewhere do not lead to, the first of each."""
        return distinct(found, pose_inaccuracy(self.base.correlation_length)[::-1])

    def at_one_drift(self, starts: Sequence[RigidTransform]) -> list[LineEvidence]:
        """Refine poses at the drift in the middle of those tried; distinct ones, best first."""
        if not self.share:
            return []
        middle = self.drifts[0][(len(self.drifts[0]) - 1) // 2]
        found = in_order(self._fit(T, middle, self._map_errors(T), COARSE_STEPS) for T in starts)
        return self.distinct(found)

    @property
    def _center(self) -> Vector3:
        return np.asarray(self.walk.positions.mean(axis=0))

    def _fit(
        self, start: RigidTransform, drift: WalkDrift, errors: np.ndarray, n_steps: int = MOST_STEPS
    ) -> LineEvidence | None:
        """Refine a pose and the walk's shape, given the map's errors there; both are integrated out.

        A step that makes the pose less probable, as where bins leave the base, is halved.
        """
        R, p = rotation_matrix(start), start.apply(self._center)
        best = self._compare(R, p, np.zeros((len(self.walk), 6)), drift, errors)
        if best is None:
            return None
        xi, share = best.step, 1.0
        for _ in range(n_steps):
            R, p = (moved[0] for moved in perturbed(best.R[None], best.p[None], xi[None]))
            found = self._compare(R, p, best.bent_after(xi, share), drift, errors)
            if found is not None and found.log_probability > best.log_probability:
                best, xi, share = found, found.step, 1.0
            else:
                xi, share = xi / 2, share / 2
            if is_close(xi, best.information):
                break
        return self._evidence(best, drift)

    def _compare(
        self, R: Matrix, p: Vector3, bent: Matrix, drift: WalkDrift, errors: np.ndarray
    ) -> "_Comparison | None":
        """Compare the walk with the base at a pose; None where too little of it lies inside."""
        known, sd, rows, slopes = self._rows(R, p, bent)
        if known.sum() < MIN_BINS:
            return None
        # What residuals would be if the walk were not bent, by their slopes where it is.
        rows[:, 0] += (slopes @ bent[known][:, :, None]).ravel()
        k = len(slopes)
        moved = drift.bending.shape[known] @ (drift.rate**2 * slopes.swapaxes(1, 2))
        moved = moved.swapaxes(0, 1).reshape(len(bent), 6, 3 * k)
        C = self._rigid_covariance(R, errors, known, sd, slopes) + (slopes @ moved[known]).reshape(3 * k, 3 * k)
        factor = np.linalg.cholesky(C)
        white = solve_triangular(factor, rows, lower=True, check_finite=False)
        most_likely = moved @ solve_triangular(factor, white, lower=True, trans=1, check_finite=False)
        r, J = white[:, 0], white[:, 1:]
        prior, slope, prior_chi2 = (x[0] for x in self.prior.rows_of_many(R[None], p[None], self._center))
        longest = np.repeat(pose_inaccuracy(self.base.correlation_length), 3)
        told = J.T @ J + np.diag((FREE_SDS * longest) ** -2)
        occam = (
            float(self.prior.log_densities(prior[None], np.array([prior_chi2]))[0])
            + float(path_weight(self.walk.length / self.base.correlation_length, known.mean()))
            - float(np.log(np.diag(factor)).sum())
            - self.null.log_likelihood(known)
        )
        step = shortened(-np.linalg.solve(told + prior, J.T @ r + slope), longest)
        chi2 = float(r @ r)
        fit = float(self.null.noise.factor(chi2, len(r))[1])
        return _Comparison(R, p, known, chi2, fit, occam, told, prior, step, bent, most_likely)

    def _evidence(self, found: "_Comparison", drift: WalkDrift) -> LineEvidence:
        """Integrate the pose out."""
        n_free = 3 * int(found.known.sum()) - 6
        inflation, log_likelihood = self.null.noise.factor(found.chi2, n_free)
        frame = inflation * drift.rate**2 * drift.bending.frame
        # A walk that fits better than expected may still share its map's errors.
        told = np.linalg.inv(found.told) * max(1.0, inflation)
        covariance, whole = (np.linalg.inv(np.linalg.inv(one) + found.prior) for one in (told, told + frame))
        rest = EACH_DRIFT - 0.5 * float(np.linalg.slogdet(found.information / (2 * np.pi))[1]) + found.occam
        rest += self.null.log_likelihood(found.known) - self.turned_null.log_likelihood(found.known)
        return LineEvidence(
            T_base_target=transform_of(found.R, found.p - found.R @ self._center),
            center=self._center,
            covariance=whole,
            overlap=float(found.known.mean()),
            log_evidence=rest + float(log_likelihood),
            attainable=rest + float(self.null.noise.factor(min(found.chi2, n_free), n_free)[1]),
            misfit=float(np.sqrt(found.chi2 / n_free)),
            is_covered=found.known,
            model=drift.model,
            drift=whole - covariance,
        )

    def _rows(self, R: Matrix, p: Vector3, bent: Matrix) -> tuple[Mask, Scalars, Matrix, np.ndarray]:
        """Bins inside the base, its sd there (k,), residuals with slopes by the pose (3 k, 7), slopes by moves."""
        y = self.walk.positions - self._center + bent[:, 3:]
        _, sd, _, known = self.base.raster.lookup(p + y @ R.T)
        y, b = y[known], Rotation.from_rotvec(bent[known, :3]).apply(self.walk.field[known])
        points, told = p + y @ R.T, np.ones((1, len(y)))
        values = self.base.posterior.evaluate(points, order=1)
        rows, slopes = residual_rows(R[None], y[None], b[None], (values.field, gradient_of(values)), told > 0, told)
        return known, sd[known], rows.reshape(3 * len(y), rows.shape[-1]), slopes[0]

    def _map_errors(self, T: RigidTransform) -> np.ndarray:
        """Covariance of the map's errors between all bins, base model axes: (n, 3, n, 3), T^2; none if learned."""
        if self.null.noise.is_learned:
            return np.zeros((0, 3, 0, 3))
        points, h = T.apply(self.walk.positions), self.base.field_map.hyperparameters
        C = self.base.field_map.posterior.influence(points) * (h.inflation * h.noise_sd) ** 2
        return np.asarray(C.reshape(len(points), 3, len(points), 3))

    def _rigid_covariance(
        self, R: Matrix, errors: np.ndarray, known: Mask, sd: Scalars, slopes: np.ndarray
    ) -> Matrix:
        """The residuals' covariance without bending, of known bins, walk's axes: (3 k, 3 k)."""
        noise = self.null.noise
        if noise.is_learned:
            return noise.full(self.walk.distance[np.ix_(known, known)], sd, slopes[:, :, 3:], self.walk.field[known])
        C = np.einsum("ai,namb,bj->nimj", R, errors[known][:, :, known], R, optimize=True)
        nugget = noise.nugget_sd**2 * np.eye(3 * known.sum())
        return np.asarray(C.reshape(nugget.shape) + nugget)


def noise_of_bins(noise_sd: float, length: float) -> PathNoise:
    """Half of the variance of a sample's noise lasts along the path, so that no bin averages it out."""
    noise = PathNoise.guess(length, 0.0, float(np.sqrt(0.5)) * noise_sd, 0.0)
    # All else is known: the map's errors, the bending.
    return replace(noise, attitude_sd=0.0, drift_sd=0.0)


def worth_bending(
    base: PreparedMap, walk: Walk, likely: Sequence[LineEvidence], noise: PathNoise, prior: PosePrior, ahead: float
) -> tuple[list[LineEvidence], list[LineEvidence]]:
    """Select poses in one of many maps that could matter if the walk bent; and the others, as weighed so far.

    More drift makes larger residuals likely, which takes evidence from a pose whose residuals are no larger than
    expected. So by the noise that a base has learned, drift lifts no pose above what it could attain without one.
    Where that noise is guessed, the map's posterior may expect less of them, and is asked at one drift; at others a
    pose may have as much more as an answer needs. ``ahead``: evidence of the best pose in other maps, nats; of none,
    0, as unrelated surveys have.
    """
    least, needed = max(0.0, ahead - CLEAR), needed_evidence(1 - RARE, LineEvidence.kind)
    some = [pose for pose in likely if pose.attainable > least]
    asked = list[LineEvidence]()
    if not some and not noise.is_learned:
        near = [pose for pose in likely if pose.attainable > ahead - CLEAR]
        if near:
            bending = BendingWalk.of(base, walk, noise, prior, is_rough=True)
            asked = bending.at_one_drift([pose.T_base_target for pose in bending.distinct(near)])
        if any(pose.attainable > least - needed for pose in asked):
            some, asked = near, []
    return some, asked or [pose for pose in likely if pose not in some]
