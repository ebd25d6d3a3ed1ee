# SPDX-License-Identifier: BSD-3-Clause
"""A pair that is compared; a pose of it in the surveys' own frames, with covariance and undetermined directions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import Hypothesis, worst_sd
from magmatch.geometry import adjoint, perturbation, perturbation_between, rotation_matrix
from magmatch.registration.result import DegenerateDirection
from magmatch.typing import Covariance6, Vector3

BaseSide = TypeVar("BaseSide")
TargetSide = TypeVar("TargetSide")


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """A pose between surveys."""

    T_base_target: RigidTransform  # survey frame to survey frame
    center: Vector3  # (3,), m: point of the target about which the covariance is stated, target's survey frame
    # (6, 6) or None: of xi in ``T_true = T_estimate Exp(xi)`` about the centre, rotation first (rad, m), target's
    # survey axes
    covariance: Covariance6 | None

    @classmethod
    def of(cls, pose: Hypothesis, T_base_model: RigidTransform, T_target_model: RigidTransform) -> "Estimate":
        """Convert a pose between model frames to one between survey frames."""
        T = T_base_model * pose.T_base_target * T_target_model.inv()
        M = np.kron(np.eye(2), rotation_matrix(T_target_model))
        covariance = None if pose.covariance is None else M @ pose.covariance @ M.T
        return cls(T, T_target_model.apply(pose.center), covariance)

    @classmethod
    def mixture(cls, models: Sequence["Estimate"], shares: Sequence[float]) -> "Estimate":
        """Moments of one pose under several models of some probability each: their spread is uncertainty, too."""
        best, weights = models[0], np.array(shares) / sum(shares)
        known = [one.covariance for one in models if one.covariance is not None]
        if len(models) == 1 or len(known) < len(models):
            return best
        c = best.center
        off = np.stack([perturbation_between(best.T_base_target, one.T_base_target, c) for one in models])
        mean, within = weights @ off, np.tensordot(weights, known, axes=1)
        spread = (off - mean).T @ (weights[:, None] * (off - mean))
        return cls(best.T_base_target * perturbation(mean, c), c, within + spread)

    def with_spread(self, covariance: Covariance6) -> "Estimate":
        """Add a further covariance to a pose; without any covariance it is unchanged."""
        return self if self.covariance is None else replace(self, covariance=self.covariance + covariance)

    @property
    def covariance_about_origin(self) -> Covariance6 | None:
        """Covariance of xi about the origin of the target's survey frame, as stated in results."""
        if self.covariance is None:
            return None
        # Turning about the origin instead of the centre moves the centre: rho = rho_c - theta x c.
        M = adjoint(RigidTransform.from_translation(self.center))
        moved = M @ self.covariance @ M.T
        symmetric: Covariance6 = (moved + moved.T) / 2
        return symmetric

    @property
    def worst_sd(self) -> tuple[float, float]:
        """Standard deviation in the worst direction, of position (m) and rotation (rad); inf if not known."""
        return (np.inf, np.inf) if self.covariance is None else worst_sd(self.covariance)

    def free_directions(self, max_sd: tuple[float, float]) -> tuple[DegenerateDirection, ...]:
        """Directions with a standard deviation above a limit (m, rad), worst first, with words in base axes."""
        if self.covariance is None or all(sd <= limit for sd, limit in zip(self.worst_sd, max_sd, strict=True)):
            return ()
        scale = np.repeat([max_sd[1], max_sd[0]], 3)
        power, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        R, found = rotation_matrix(self.T_base_target), []
        for k in np.flatnonzero(power > 1.0)[::-1]:
            theta, rho = np.split(vectors[:, k] * scale, 2)
            xi = np.concatenate([theta, rho - np.cross(theta, self.center)])
            is_turn = np.linalg.norm(vectors[:3, k]) > np.linalg.norm(vectors[3:, k])
            motion, along = ("turning about", theta) if is_turn else ("sliding along", rho)
            found.append(DegenerateDirection(xi / np.linalg.norm(xi), f"{motion} base {_axis_words(R @ along)}"))
        return tuple(found)


@dataclass(frozen=True, eq=False, slots=True)
class Pair(Generic[BaseSide, TargetSide]):
    """Base and target prepared for a strategy, and the pose prior."""

    base: BaseSide
    target: TargetSide
    prior: PosePrior
    length: float  # m: correlation length of the field, the scale of tolerances
    # Survey frames from the frames in which poses are searched
    T_base_model: RigidTransform
    T_target_model: RigidTransform

    def estimate(self, pose: Hypothesis) -> Estimate:
        """A pose of this pair in the surveys' frames."""
        return Estimate.of(pose, self.T_base_model, self.T_target_model)


def _axis_words(v: np.ndarray) -> str:
    v = v / np.linalg.norm(v)
    k = int(np.argmax(np.abs(v)))
    if abs(v[k]) > 0.9:
        return "xyz"[k]
    return "direction ({:+.2f}, {:+.2f}, {:+.2f})".format(*(v * np.sign(v[k])))
