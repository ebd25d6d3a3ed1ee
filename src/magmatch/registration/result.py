# SPDX-License-Identifier: BSD-3-Clause
"""The result of a registration, its uncertainty, and the reason for a refusal: one typed document."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, GetPydanticSchema, Strict, WrapValidator
from pydantic_core.core_schema import no_info_after_validator_function
from scipy.spatial.transform import RigidTransform
from typing_extensions import TypedDict

from magmatch.data.document import TypedDocument
from magmatch.geometry import covariance_about, near_origin, transform_from_matrix, transform_points
from magmatch.number_text import told
from magmatch.picture import BASE, TARGET, points_picture, share_picture, with_picture

MAX_LINKS = 300
# Rounding that a covariance from elsewhere may show, relative to its standard deviations (units differ by entry).
COVARIANCE_TOLERANCE = 1e-9
UNIT_TOLERANCE = 1e-6

T = TypeVar("T")
Number = Annotated[float, Strict()]
# NaN is written as null.
NULL_IS_NAN = WrapValidator(lambda value, read: math.nan if value is None else read(value))
NumberOrNull = Annotated[Number, NULL_IS_NAN]
Fraction = Annotated[Number, Field(ge=0, le=1)]
Length = Annotated[Number, Field(ge=0)]
Count = Annotated[int, Strict(), Field(ge=0)]
Three = Annotated[list[T], Field(min_length=3, max_length=3)]
Four = Annotated[list[T], Field(min_length=4, max_length=4)]
Six = Annotated[list[T], Field(min_length=6, max_length=6)]


def _read_as(rows: Any, then: Callable[[Any], Any]) -> GetPydanticSchema:
    """Validate a field as lists of numbers, then convert them to the field's type."""
    return GetPydanticSchema(lambda _, handler: no_info_after_validator_function(then, handler.generate_schema(rows)))


def _covariance(rows: list[list[float]]) -> np.ndarray:
    """Symmetric and positive semidefinite up to rounding."""
    C = np.array(rows, dtype=np.float64)
    variance = C.diagonal()
    _expect((variance >= 0).all(), "variances that are not negative", variance.tolist())
    sd = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = C / sd / sd[:, None]
    asymmetry = float(np.abs(correlation - correlation.T).max())
    _expect(asymmetry <= COVARIANCE_TOLERANCE, "a symmetric matrix", rows)
    lowest = float(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0])
    semidefinite = f"a positive semidefinite matrix (lowest eigenvalue {lowest:.1e})"
    _expect(lowest >= -COVARIANCE_TOLERANCE, semidefinite, rows)
    return C


def _unit_vector(xi: list[float]) -> np.ndarray:
    _expect(abs(math.hypot(*xi) - 1) <= UNIT_TOLERANCE, "a unit vector", xi)
    return np.array(xi, dtype=np.float64)


def _near_identity(matrix: list[list[float]]) -> list[list[float]]:
    _expect(0.1 < np.linalg.det(matrix) < 10, "a matrix near the identity", matrix)
    return matrix


def _expect(is_so: Any, expected: str, found: Any) -> None:
    if not is_so:
        msg = f"expected {expected}, found {json.dumps(found)[:60]}"
        raise ValueError(msg)


Transform = Annotated[RigidTransform, _read_as(Four[Four[Number]], transform_from_matrix)]
Covariance = Annotated[np.ndarray, _read_as(Six[Six[Number]], _covariance)]
Rows = Annotated[np.ndarray, _read_as(list[Three[Number]], lambda rows: np.array(rows, dtype=float).reshape(-1, 3))]


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
    """Another pose that explains the data."""

    T_base_target: Transform
    probability: Fraction | None = None  # None where not computed
    # Name of the map, if the base was a folder and the pose is in another map than the result's
    base: str | None = None
    log_odds: Number | None = None  # nats
    # In the worst direction, where the target lies: of rotation (rad) and position (m); None where not stated
    sd: tuple[Length, Length] | None = None


@dataclass(frozen=True, slots=True)
class DegenerateDirection:
    """A direction of the tangent space that the data do not determine: unit 6-vector in target axes, and words."""

    xi: Annotated[np.ndarray, _read_as(Six[Number], _unit_vector)]
    words: str


@dataclass(frozen=True, eq=False, slots=True)
class Links:
    """Corresponding points that support the answer, for pictures: row i of one belongs to row i of the other."""

    base: Rows  # (k, 3), m, base frame
    target: Rows  # (k, 3), m, target frame

    def few(self) -> "Links":
        """At most `MAX_LINKS` finite pairs, evenly chosen."""
        rows = np.flatnonzero(np.isfinite(self.base).all(axis=1) & np.isfinite(self.target).all(axis=1))
        rows = rows[np.linspace(0, len(rows) - 1, min(MAX_LINKS, len(rows))).astype(int)]
        return Links(self.base[rows], self.target[rows])


NO_LINKS = Links(np.zeros((0, 3)), np.zeros((0, 3)))


def _pairs(links: Links) -> Links:
    numbers = [len(links.base), len(links.target)]
    _expect(numbers[0] == numbers[1] <= MAX_LINKS, f"equal numbers of points, at most {MAX_LINKS}", numbers)
    return links


class Calibration(TypedDict):
    """The correction of a survey's own sensor: ``b_true = matrix b_read - shift``, sensor frame."""

    time_offset: Number  # s, added to the magnetometer's times
    matrix: Annotated[Three[Three[Number]], AfterValidator(_near_identity)]
    shift: Three[Number]  # T


class Sensor(TypedDict, total=False):
    """Differences of the target's magnetometer from the base's, in the target's axes, and the corrections of each."""

    bias: Three[NumberOrNull]  # T
    scale: NumberOrNull
    gain: Three[Three[NumberOrNull]]  # of which `scale` is the mean of the diagonal
    prior_sd: list[NumberOrNull]
    calibrated: dict[Annotated[str, Field(pattern="^(base|target)$")], Calibration]


@dataclass(frozen=True, eq=False, slots=True)
class RegistrationResult(TypedDocument):
    """The answer of `register`, accepted or not; fields are in the order of the file.

    Attributes
    ----------
    status, reason
        The verdict, and in words why and what the user can do.
    base : str or None
        Name of the map, if the base was a folder.
    T_base_target : RigidTransform or None
        ``p_base = T p_target``; None unless accepted.
    covariance : (6, 6) array or None
        Of xi in ``T_true = T_estimate Exp(xi)``, rotation first (rad, m); None unless accepted and known.
    probability : float or None
        Calibrated probability that the transform is right (see `estimation/posterior.py`); of the
        first alternative if nothing was accepted; None with the published method.
    evidence : dict
        The figures behind the probability: evidence (``log_odds``, nats) for the best pose, how much of it is
        ``effective``, its ``lead`` over any other pose (None if there is none), and the shares that agree.
    overlap : float
        Fraction of the target's samples that fall where the base map knows the field.
    alternatives : tuple of Alternative
        Other poses, best first; starts with the best candidate if nothing was accepted.
    sensor : Sensor or None
        A dict: the differences between the magnetometers, if estimated, and the prior correction of each survey's own
        sensor (``calibrated``), if its readings required one.
    residual : float or None
        Normalised rms field residual over the overlap (1 if model and noise explain everything).
    fitness : float or None
        Of the published method: mean norm of the cross product of aligned vectors, over the mean product of their
        norms. Preset ``paper-literal`` decides by the former alone, which ``reason`` states.
    n_inliers, n_keypoints, n_correspondences : int
        Counts; ``keypoints`` of both maps together.
    seconds : dict
        Per stage and total.
    config, version, seed, inputs
        Enough to repeat the run and get the same numbers.
    """

    SCHEMA = "magmatch.registration/1"
    KIND = "registration result"
    MAX_BYTES = 64 * 1024**2

    @staticmethod
    def key(name: str) -> str:
        """Key in the file for a field: counts are named by what they count."""
        return name.removeprefix("n_")

    __pydantic_config__: ClassVar = ConfigDict(alias_generator=key)

    status: Status
    reason: Annotated[str, Field(default="")]  # files from elsewhere need not have one
    base: str | None = field(default=None, kw_only=True)
    T_base_target: Transform | None
    covariance: Covariance | None = None
    probability: Fraction | None = None
    evidence: dict[str, Number | None] = field(default_factory=dict)
    overlap: Annotated[Fraction, NULL_IS_NAN] = 0.0
    alternatives: tuple[Alternative, ...] = ()
    degenerate_directions: tuple[DegenerateDirection, ...] = ()
    sensor: Sensor | None = None
    residual: Number | None = None
    fitness: Number | None = None
    n_inliers: Count = 0
    n_keypoints: Count = 0
    n_correspondences: Count = 0
    # By a factory: a schema cannot show arrays as a default.
    links: Annotated[Links, AfterValidator(_pairs)] = field(default_factory=lambda: NO_LINKS)
    seconds: dict[str, NumberOrNull] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: Count = 0
    inputs: tuple[dict[str, Any], ...] = ()

    def __repr__(self) -> str:
        sure = "" if self.probability is None else f", probability {self.probability:.4g}"
        lines = [f"RegistrationResult: {self.status}{sure}{f', map {self.base}' if self.base else ''}", self.reason]
        if self.T_base_target is not None:
            x, y, z = (told(v, 4, 1e-3) for v in self.T_base_target.translation)
            turn = math.degrees(self.T_base_target.rotation.magnitude())
            lines[1:1] = [f"T_base_target: {x}, {y}, {z} m, turned by {turn:.4g} degrees"]
        return "\n".join(" ".join(line.split()) for line in lines)

    def _repr_html_(self) -> str:
        links, pose = self.links.few(), self.best_pose
        if pose is not None and len(links.base):
            moved = transform_points(links.target, pose)
            picture = points_picture(
                [(links.base, BASE), (moved, TARGET)], "points of base and target that belong together"
            )
        else:
            sure = self.probability or 0.0
            picture = share_picture(sure, f"probability {sure:.4g}")
        return with_picture(repr(self), picture)

    @property
    def is_accepted(self) -> bool:
        """Whether a transform is given."""
        return self.status is Status.ACCEPTED

    @property
    def best_pose(self) -> RigidTransform | None:
        """The accepted pose, or the best candidate of a refusal, which is not to be trusted."""
        if self.T_base_target is not None:
            return self.T_base_target
        return self.alternatives[0].T_base_target if self.alternatives else None

    @property
    def standard_deviations(self) -> tuple[float, float] | None:
        """Standard deviations of the rotation (rad) and of the target's position (m); None if not known.

        The covariance is about the target frame's origin, which may be far from its samples, where every rotation is
        a large shift. The position is that of the point whose shift does not correlate with the rotation.
        """
        if self.covariance is None:
            return None
        C = covariance_about(self.covariance, near_origin(self.links.target, 1.0))
        turn, cross, shift = C[:3, :3], C[3:, :3], C[3:, 3:]
        at_target = shift - cross @ np.linalg.solve(turn, cross.T)
        return float(np.sqrt(np.trace(turn))), float(np.sqrt(max(float(np.trace(at_target)), 0.0)))

    def fault(self) -> tuple[str, str] | None:
        """A transform or a covariance that contradicts the status."""
        if (self.T_base_target is not None) != self.is_accepted:
            said = f"{'null' if self.T_base_target is None else 'given'} with '{self.status}'"
            return "T_base_target", f"expected a transform exactly where accepted, {said}"
        if self.covariance is not None and not self.is_accepted:
            return "covariance", "expected null where nothing was accepted"
        return None

    def to_dict(self) -> dict[str, Any]:
        """The result as lists, numbers and strings, with keys and order as in the file."""
        is_known = self.covariance is not None and np.isfinite(self.covariance).all()
        stated = replace(self, covariance=self.covariance if is_known else None, links=self.links.few())
        document = TypedDocument.to_dict(stated)
        for alternative in document["alternatives"]:
            # It stands last, and only where there is one.
            base = alternative.pop("base")
            alternative.update({} if base is None else {"base": base})
        return document
