# SPDX-License-Identifier: BSD-3-Clause
"""The estimate of the body's pose at one moment."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.brief import brief
from magmatch.estimation.posterior import worst_sd
from magmatch.geometry import transform_from_product
from magmatch.typing import Covariance6, Matrix, Vector3


class LocalizerStatus(StrEnum):
    """Whether the pose is known, and how; where it is not, the place may be (see `phase`)."""

    SEARCHING = "searching"  # it was never known
    LOCALIZED = "localized"  # by the field, to the required accuracy
    DEAD_RECKONING = "dead_reckoning"  # outside what the map knows, still to the required accuracy
    LOST = "lost"  # it was known, and is no longer


def phase(status: LocalizerStatus, *, is_place_known: bool) -> str:
    """Name a part of a log: that the place is known is one thing, how well the pose is known another."""
    if is_place_known and status in {LocalizerStatus.SEARCHING, LocalizerStatus.LOST}:
        return "place known, pose too uncertain"
    return status.replace("_", " ")


@dataclass(frozen=True, eq=False, slots=True)
class PoseHypothesis:
    """A pose that the body may have: name of the map, ``T_map_body`` and its probability."""

    map: str
    T_map_body: RigidTransform
    probability: float


@dataclass(frozen=True, eq=False, slots=True)
class PoseEstimate:
    """The pose of the body, and how well it is known.

    Attributes
    ----------
    status : LocalizerStatus
    reason : str
        The reason of the status, in words.
    matrix : (4, 4) array or None
        Of ``T_map_body``, the map's frame from the body's; None unless localized or dead reckoning.
    covariance : (6, 6) array or None
        Of xi in ``T_true = T Exp(xi)``, rotation first (rad, m), body's axes.
    probability : float
        That the best hypothesis has the right place, however accurate its pose is.
    bias, bias_sd : (3,) arrays or None, T
        Of the sensor, body's axes.
    scale : float or None
        True length of a step over that of the odometry.
    map : str or None
        Name of the map.
    gain : float or None
        Ratio of the sensor's readings to those of the map's sensor.
    drift : float or None
        Standard deviation of the odometry's drift over the stated one, as the path so far shows it.
    is_place_known : bool
        Whether that probability is high enough, and has been for long enough; no pose is stated all the same where
        its covariance is too large.
    """

    status: LocalizerStatus
    reason: str
    matrix: Matrix | None = None
    covariance: Covariance6 | None = None
    probability: float = 0.0
    bias: Vector3 | None = None
    bias_sd: Vector3 | None = None
    scale: float | None = None
    map: str | None = None
    gain: float | None = None
    drift: float | None = None
    is_place_known: bool = False

    __repr__ = brief

    @property
    def phase(self) -> str:
        """The status in words, in which a known place and an uncertain pose are told apart."""
        return phase(self.status, is_place_known=self.is_place_known)

    @property
    def is_stated(self) -> bool:
        """Whether a pose is stated."""
        return self.matrix is not None

    @property
    def T_map_body(self) -> RigidTransform | None:
        """Map's frame from the body's, computed on demand; None unless localized or dead reckoning."""
        return None if self.matrix is None else transform_from_product(self.matrix)


def if_accurate(estimate: PoseEstimate, most: tuple[float, float]) -> PoseEstimate:
    """The estimate; one whose pose has larger standard deviations than allowed (m, rad) states the place only."""
    if estimate.covariance is None or not (off := too_uncertain(estimate.covariance, most)):
        return estimate
    words = uncertain_words(estimate.reason, off)
    return PoseEstimate(LocalizerStatus.LOST, words, probability=estimate.probability, is_place_known=True)


def too_uncertain(covariance: Covariance6, most: tuple[float, float]) -> str:
    """How far a pose's standard deviations, in the worst direction, exceed the limits (m, rad); nothing if not."""
    variances, (shift_limit, turn_limit) = covariance.diagonal().tolist(), most
    # No direction is worse than all axes together.
    if sum(variances[3:]) <= shift_limit**2 and sum(variances[:3]) <= turn_limit**2:
        return ""
    shift, turn = worst_sd(covariance)
    if shift <= shift_limit and turn <= turn_limit:
        return ""
    words = f"sd {shift:.3g} m, {np.degrees(turn):.3g} degrees"
    return f"{words}; at most {shift_limit:.3g} m, {np.degrees(turn_limit):.3g} degrees are asked for (--max-sd)"


def uncertain_words(found: str, off: str) -> str:
    """Say that a place is known, and how far its pose exceeds the limits."""
    return f"the place is known ({found}), but the pose is too uncertain: {off}"
