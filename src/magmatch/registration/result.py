# SPDX-License-Identifier: BSD-3-Clause
"""The last noun: what registration found, how sure it is, and why it refused when it did."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.document import write_document
from magmatch.registration.parts import Alternative, DegenerateDirection, Links, Status
from magmatch.registration.serialization import document_of, read_result_document
from magmatch.registration.validation import fields_of

__all__ = ["Alternative", "DegenerateDirection", "Links", "RegistrationResult", "Status"]


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
        Calibrated probability that the transform is right (see `registration/decide/probability.py`); of the
        first alternative where nothing was accepted; None with the published method.
    evidence : dict
        What the probability was computed from: ``log_odds`` (nats) of the best pose, its ``lead`` over the best pose
        elsewhere (None where there is none), and the shares that agree.
    overlap : float
        Fraction of the target's samples that fall where the base map knows the field.
    alternatives : tuple of Alternative
        Other poses, best first; the best candidate stands first where nothing was accepted.
    sensor : dict or None
        Bias (T) and scale between the magnetometers, when estimated; and what was undone of each survey's own sensor
        first (``calibrated``), where its readings showed it.
    residual : float or None
        Normalised rms field residual over the overlap (1 when model and noise explain everything).
    fitness : float or None
        Mean norm of the cross product of aligned vectors, T (normalised as the configuration says).
    n_inliers, n_keypoints, n_correspondences : int
        Counts; ``keypoints`` of both maps together.
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
    evidence: dict[str, float | None] = field(default_factory=dict)
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

    @property
    def best_pose(self) -> RigidTransform | None:
        """The accepted pose, else the best candidate of a refusal; not to be trusted unless accepted."""
        if self.T_base_target is not None:
            return self.T_base_target
        return self.alternatives[0].T_base_target if self.alternatives else None

    @property
    def standard_deviations(self) -> tuple[float, float] | None:
        """How sure the pose is: of the turn (rad) and of the place where the target lies (m); None if not known.

        The covariance is about the target frame's origin, which may be far from its samples, where every turn is a
        large shift. The place that the data fix best is the one whose shift does not correlate with the turn.
        """
        if self.covariance is None:
            return None
        turn, cross, shift = self.covariance[:3, :3], self.covariance[3:, :3], self.covariance[3:, 3:]
        at_target = shift - cross @ np.linalg.solve(turn, cross.T)
        return float(np.sqrt(np.trace(turn))), float(np.sqrt(max(float(np.trace(at_target)), 0.0)))

    def to_dict(self) -> dict[str, Any]:
        """What the result says, in lists, numbers and words, keys and order as in the file."""
        return document_of(self)

    def save(self, path: str | Path) -> None:
        """Write the result as JSON (layout in ``docs/conventions.md``), whole or not at all.

        Parameters
        ----------
        path : path
            Where; an existing file is replaced.

        Raises
        ------
        DataFormatError
            The folder does not exist.
        """
        write_document(path, self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> "RegistrationResult":
        """Read a result; saving it again gives the same bytes.

        Parameters
        ----------
        path : path
            A file that `save` wrote, or JSON of the same layout from elsewhere.

        Returns
        -------
        RegistrationResult

        Raises
        ------
        DataFormatError
            Not such a file, or one of its values cannot be; names the key.
        """
        return cls(**fields_of(read_result_document(path), path))
