# SPDX-License-Identifier: BSD-3-Clause
"""The last noun: what registration found, how sure it is, and why it refused when it did."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform


class Status(StrEnum):
    """Why a registration was accepted or not."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"  # another pose explains the data nearly as well
    DEGENERATE = "degenerate"  # the data leave a direction free
    NO_OVERLAP = "no_overlap"  # the surveys do not cover a common region
    UNINFORMATIVE = "uninformative"  # the field has too little structure to tell places apart
    INCONSISTENT = "inconsistent"  # the best pose found does not explain the field


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another pose that explains the data, with its probability (None where not computed)."""

    T_base_target: RigidTransform
    probability: float | None = None


@dataclass(frozen=True, slots=True)
class DegenerateDirection:
    """A direction of the tangent space that the data do not fix: unit 6-vector in target axes, and words."""

    xi: np.ndarray
    words: str


@dataclass(frozen=True, eq=False, slots=True)
class Links:
    """Corresponding points that support the answer, for pictures: row i of one belongs to row i of the other."""

    base: np.ndarray  # (k, 3), m, base frame
    target: np.ndarray  # (k, 3), m, target frame


@dataclass(frozen=True, eq=False, slots=True)
class RegistrationResult:
    """The answer of `register`, accepted or not; `to_dict` is the JSON of schema ``magmatch.registration/1``.

    Attributes
    ----------
    status, reason
        Which check decided, and in words what the user can do about it.
    T_base_target : RigidTransform or None
        ``p_base = T p_target``; None unless accepted.
    covariance : (6, 6) array or None
        Of xi in ``T_true = T_estimate Exp(xi)``, rotation first (rad, m); None unless accepted, or not known.
    probability : float or None
        Calibrated probability that the transform is right; None while no calibrated model exists.
    overlap : float
        Fraction of the target's samples that fall where the base map knows the field.
    alternatives : tuple of Alternative
        Other poses, best first; the best candidate stands first where nothing was accepted.
    degenerate_directions : tuple of DegenerateDirection
    sensor : dict or None
        Bias (T) and scale between the magnetometers, when estimated.
    residual : float or None
        Normalised rms field residual over the overlap (1 when model and noise explain everything).
    fitness : float or None
        Mean norm of the cross product of aligned vectors, T (normalised as the configuration says).
    n_inliers, n_keypoints, n_correspondences : int
        Counts; ``keypoints`` of both maps together.
    links : Links
    seconds : dict
        Per stage and total.
    config, version, seed, inputs
        Enough to run it again and get the same numbers.
    base : str or None
        Which map, where the base was a folder.
    """

    status: Status
    reason: str
    T_base_target: RigidTransform | None
    covariance: np.ndarray | None = None
    probability: float | None = None
    overlap: float = 0.0
    alternatives: tuple[Alternative, ...] = ()
    degenerate_directions: tuple[DegenerateDirection, ...] = ()
    sensor: dict[str, Any] | None = None
    residual: float | None = None
    fitness: float | None = None
    n_inliers: int = 0
    n_keypoints: int = 0
    n_correspondences: int = 0
    links: Links = field(default_factory=lambda: Links(np.zeros((0, 3)), np.zeros((0, 3))))
    seconds: dict[str, float] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: int = 0
    inputs: tuple[dict[str, Any], ...] = ()
    base: str | None = None

    @property
    def is_accepted(self) -> bool:
        """Whether a transform is given."""
        return self.status is Status.ACCEPTED
