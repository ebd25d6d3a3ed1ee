# SPDX-License-Identifier: BSD-3-Clause
"""The pose prior: only the region, a common vertical, or a rough pose.

A prior enters three times. Poses that it rules out are not searched; its rows are added to the residuals' in every
refinement (and so to the covariance); and its density is the search penalty in the evidence: ``1 / (volume 8 pi^2)``
over all poses, ``1 / (volume 2 pi)`` over rotations about the vertical, both divided by the share of poses that put
the target inside the base (`inside`); about a rough pose it is a Gaussian.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field, field_validator
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import chdtri

from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.estimation.limits import MOST_DRAWN
from magmatch.geometry import perturbation, product, rotation_matrix, skew
from magmatch.settings import Settings
from magmatch.typing import Covariance6, Mask, Matrix, Points, Scalars, Tensors, Vector3

# Share of right values that are taken for wrong ones, and the squared norm of a normal vector, in its variance, that
# only this share exceeds.
RARE = 0.01
FAR2 = float(chdtri(3, RARE))
# Standard deviation of the vertical in a survey's frame, rad: a good accelerometer at rest, a robot's floor.
ATTITUDE_SD = 0.01
UP = np.array([0.0, 0.0, 1.0])


class PosePriorConfig(Settings):
    """Knowledge of the pose beforehand; nothing by default."""

    # Rough T_base_target: x, y, z (m), then the quaternion qx, qy, qz, qw.
    pose: tuple[float, float, float, float, float, float, float] | None = None
    # Standard deviations of the rough pose: of the position of the target's centroid, per axis (m), and of its
    # rotation about any axis (rad).
    sd_translation: float = Field(default=1.0, gt=0)
    sd_rotation: float = Field(default=0.17, gt=0)
    # Whether z points up in both surveys, so that only heading and place are unknown.
    is_gravity_aligned: bool = False
    # Standard deviation of this, per axis (rad).
    gravity_sd: float = Field(default=ATTITUDE_SD, gt=0)
    # Whether both surveys also share the same height, as on one floor; and its standard deviation (m).
    is_planar: bool = False
    height_sd: float = Field(default=0.05, gt=0)

    @field_validator("pose")
    @classmethod
    def _has_a_rotation(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and (not np.isfinite(value).all() or abs(np.linalg.norm(value[3:]) - 1) > 1e-2):
            msg = "expected x, y, z and a unit quaternion qx, qy, qz, qw"
            raise ValueError(msg)
        return value

    @property
    def is_upright(self) -> bool:
        """Whether z points up in both surveys."""
        return self.is_gravity_aligned or self.is_planar

    def transform(self) -> RigidTransform | None:
        """The rough ``T_base_target``."""
        if self.pose is None:
            return None
        return RigidTransform.from_components(np.array(self.pose[:3]), Rotation.from_quat(self.pose[3:]))


@dataclass(frozen=True, eq=False, slots=True)
class PosePrior:
    """A prior of the pose between two model frames."""

    volume: float  # m^3: of the region in which the target may lie
    T_base_target: RigidTransform | None = None  # rough pose
    # (6, 6): of xi in ``T Exp(xi)`` about the middle of the target, for the rough pose; rotation first (rad, m)
    covariance: Covariance6 | None = None
    up_base: Vector3 | None = None  # (3,): the vertical in either model frame
    up_target: Vector3 | None = None
    gravity_sd: float = ATTITUDE_SD  # rad
    # m: vertical coordinate in the base's model frame minus that in the target's, if surveys share their height
    height: float | None = None
    # m: its standard deviation, and the range of heights that the target could have if it were unknown
    height_sd: float = PosePriorConfig().height_sd
    height_range: float = np.nan
    # Natural logarithm of the weighted share of these poses that put the target inside the base
    log_share_inside: float = 0.0
    # Squared distance from the rough pose, in its variance, beyond which no pose is admitted
    far2: float = FAR2

    @property
    def is_flat(self) -> bool:
        """Whether all poses in the region are equally likely."""
        return self.T_base_target is None and self.up_base is None

    def log_density(self, T: RigidTransform, center: Vector3, covariance: Covariance6 | None = None) -> float:
        """Natural logarithm of the prior, per m^3 and rad^3, at a pose or on average over its covariance.

        The centre (m) is the middle of the target; the covariance is of xi in ``T Exp(xi)`` about it.
        """
        if self.is_flat:
            return float(self._log_norms(np.zeros((1, 6, 6)))[0])
        A, v, chi2 = self.rows(T, center)
        log_norm = float(self._log_norms(A[None])[0])
        if covariance is not None:
            # The mean of exp(-chi^2 / 2) over the estimate's spread.
            spread = np.eye(6) + covariance @ A
            chi2 -= float(v @ np.linalg.solve(spread, covariance @ v))
            log_norm -= 0.5 * np.linalg.slogdet(spread)[1]
        return float(log_norm - 0.5 * chi2)

    def log_densities(self, information: np.ndarray, chi2: Scalars) -> Scalars:
        """`log_density` of many poses, of which `rows_of_many` gave the information (h, 6, 6) and chi^2 (h,)."""
        return self._log_norms(information) - 0.5 * chi2

    def _log_norms(self, A: np.ndarray) -> Scalars:
        """Log density at the prior's mode, for information matrices (h, 6, 6)."""
        if self.T_base_target is not None:
            return np.asarray(0.5 * np.linalg.slogdet(A / (2 * np.pi))[1])
        log_norm = -np.log(max(self.volume, np.finfo(float).tiny)) - self.log_share_inside
        if self.up_base is None:
            log_norm -= np.log(8 * np.pi**2)
        else:
            log_norm -= np.log(2 * np.pi) + np.log(2 * np.pi * self.gravity_sd**2)
            if self.height is not None:
                log_norm += np.log(self.height_range / self.height_sd) - 0.5 * np.log(2 * np.pi)
        return np.full(len(A), log_norm)

    def combined(
        self, T: RigidTransform, center: Vector3, covariance: Covariance6
    ) -> tuple[RigidTransform, Covariance6]:
        """Combine a pose from the data alone, with its covariance, and the prior, as two Gaussians."""
        A, v, _ = self.rows(T, center)
        both = np.linalg.solve(np.eye(6) + covariance @ A, covariance)
        both = (both + both.T) / 2
        return T * perturbation(-both @ v, center), both

    def taken_out(
        self, T: RigidTransform, center: Vector3, covariance: Covariance6
    ) -> tuple[RigidTransform, Covariance6]:
        """The pose and covariance of the data alone, from those that hold the prior too: undoes `combined`."""
        A, v, _ = self.rows(T, center)
        alone = np.linalg.inv(np.linalg.inv(covariance) - A)
        alone = (alone + alone.T) / 2
        return product(T, perturbation(alone @ v, center)), alone

    def rows(self, T: RigidTransform, center: Vector3) -> tuple[Matrix, np.ndarray, float]:
        """Information of the prior on the perturbation ``T Exp(xi)`` about a centre (m), the middle of the target.

        Returns the information (6, 6), the gradient (6,) of half the squared residual with respect to xi, and the
        squared residual over its variance.
        """
        A, v, chi2 = self.rows_of_many(rotation_matrix(T)[None], T.apply(center)[None], center)
        return A[0], v[0], float(chi2[0])

    def rows_of_many(self, R: Tensors, moved: Points, center: Vector3) -> tuple[np.ndarray, Matrix, Scalars]:
        """`rows` of many poses at once: rotations R (h, 3, 3), which put the centre at ``moved`` (h, 3)."""
        h = len(R)
        A, v, chi2 = np.zeros((h, 6, 6)), np.zeros((h, 6)), np.zeros(h)
        if self.up_base is not None and self.up_target is not None:
            up = self.up_base @ R  # in the target's axes
            off, J = self.up_target - up, -skew(up)
            A[:, :3, :3] += np.swapaxes(J, 1, 2) @ J / self.gravity_sd**2
            v[:, :3] += np.cross(up, off) / self.gravity_sd**2
            chi2 += (off**2).sum(axis=1) / self.gravity_sd**2
            if self.height is not None:
                too_high = moved @ self.up_base - (float(center @ self.up_target) + self.height)
                A[:, 3:, 3:] += up[:, :, None] * up[:, None] / self.height_sd**2
                v[:, 3:] += up * too_high[:, None] / self.height_sd**2
                chi2 += too_high**2 / self.height_sd**2
        if self.T_base_target is not None and self.covariance is not None:
            information = np.linalg.inv(self.covariance)
            turns, r = self._off_rough(R, moved, center)
            # To first order in the angle already there.
            J = np.tile(np.eye(6), (h, 1, 1))
            J[:, :3, :3] += 0.5 * skew(r[:, :3])
            J[:, 3:, 3:] = turns
            A += np.swapaxes(J, 1, 2) @ information @ J
            v += np.einsum("ha,hab->hb", r @ information, J)
            chi2 += np.einsum("ha,ha->h", r @ information, r)
        return A, v, chi2

    def _off_rough(self, R: Tensors, moved: Points, center: Vector3) -> tuple[Tensors, Matrix]:
        """How poses are off the rough one, in its axes: turns (h, 3, 3); rotation vectors and shifts (h, 6)."""
        assert self.T_base_target is not None
        R_rough = rotation_matrix(self.T_base_target)
        turns = R_rough.T @ R
        shifts = (moved - self.T_base_target.apply(center)) @ R_rough
        return turns, np.concatenate([Rotation.from_matrix(turns).as_rotvec(), shifts], axis=1)

    def admits(self, R: Tensors, moved: Points, center: Vector3, slack: tuple[float, float]) -> Mask:
        """Whether the prior admits poses: rotations R (h, 3, 3) that put the target's middle at ``moved`` (h, 3), m.

        ``slack`` (rad, m): standard deviations of the poses themselves.
        """
        is_admitted = np.ones(len(R), dtype=bool)
        if self.up_base is not None:
            tilt = np.arccos(np.clip((R @ self.up_target) @ self.up_base, -1.0, 1.0))
            is_admitted &= tilt < np.sqrt(FAR2) * np.hypot(self.gravity_sd, slack[0])
            if self.height is not None:
                off = np.abs(moved @ self.up_base - center @ self.up_target - self.height)
                is_admitted &= off < np.sqrt(FAR2) * np.hypot(self.height_sd, slack[1])
        if self.T_base_target is not None and self.covariance is not None:
            r = self._off_rough(R, moved, center)[1]
            for k, part in enumerate((slice(0, 3), slice(3, 6))):
                wide = np.linalg.inv(self.covariance[part, part] + slack[k] ** 2 * np.eye(3))
                is_admitted &= np.einsum("ha,ab,hb->h", r[:, part], wide, r[:, part]) < self.far2
        return is_admitted

    def draw(self, n: int, center: Vector3, rng: np.random.Generator) -> tuple[Tensors, Points]:
        """Poses about the rough one, which comes first: rotations, and where each puts the middle of the target, m.

        Empty if there is no rough pose.
        """
        if self.T_base_target is None or self.covariance is None:
            return np.zeros((0, 3, 3)), np.zeros((0, 3))
        power, axes = np.linalg.eigh(self.covariance)
        xi = rng.standard_normal((n, 6)) * np.sqrt(np.maximum(power, 0.0)) @ axes.T
        xi[:1] = 0.0
        R = rotation_matrix(self.T_base_target) @ Rotation.from_rotvec(xi[:, :3]).as_matrix()
        return R, self.T_base_target.apply(center + xi[:, 3:])

    def _n_drawn(self, slack: tuple[float, float], n_anchors: int) -> int:
        """Number of poses that cover the rough one's spread: for each that the search resolves, one a direction.

        Each anchor has one at least.
        """
        if self.covariance is None:
            return 0
        scale = np.repeat(slack, 3)
        power = np.linalg.eigvalsh(self.covariance / np.outer(scale, scale))
        places = len(power) * float(np.prod(np.sqrt(np.maximum(power, 1.0))))
        return int(min(max(places, n_anchors), MOST_DRAWN))

    def narrow(
        self, poses: CandidatePoses, center: Vector3, slack: tuple[float, float], rng: np.random.Generator
    ) -> CandidatePoses:
        """Remove hypotheses that the prior rules out, and add poses about a rough one, at the same anchors.

        ``slack`` (rad, m): standard deviations of the poses themselves.
        """
        if self.is_flat:
            return poses
        kept = poses.subset(np.flatnonzero(self.admits(poses.rotations, poses.carry(center), center, slack)))
        drawn, moved = self.draw(self._n_drawn(slack, len(poses.anchors_target)), center, rng)
        rows = np.arange(len(drawn), dtype=np.int64) % len(poses.anchors_target)
        anchors = moved + np.einsum("nij,nj->ni", drawn, poses.anchors_target[rows] - center)
        return CandidatePoses(
            np.concatenate([kept.rotations, drawn]),
            np.concatenate([kept.anchors_base, anchors]),
            np.concatenate([kept.anchor_rows, rows]),
            poses.anchors_target,
        )


def pose_prior(
    config: PosePriorConfig,
    T_base_model: RigidTransform,
    T_target_model: RigidTransform,
    volume: float,
    height_range: float = 1.0,
) -> PosePrior:
    """State a prior between the model frames of two surveys."""
    T = config.transform()
    # The same height between survey frames: h_base + z_base = h_target + z_target.
    height = float(T_target_model.translation[2] - T_base_model.translation[2]) if config.is_planar else None
    return PosePrior(
        volume=volume,
        T_base_target=None if T is None else product(T_base_model.inv(), T, T_target_model),
        covariance=None if T is None else np.diag(np.repeat([config.sd_rotation**2, config.sd_translation**2], 3)),
        up_base=UP @ rotation_matrix(T_base_model) if config.is_upright else None,
        up_target=UP @ rotation_matrix(T_target_model) if config.is_upright else None,
        gravity_sd=config.gravity_sd,
        height=height,
        height_sd=config.height_sd,
        height_range=height_range,
    )
