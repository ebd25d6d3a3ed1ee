# SPDX-License-Identifier: BSD-3-Clause
"""Errors in a survey's frames and units that the survey itself reveals: kind, measurement, remedy.

One principle: the Earth's part of the field is the same vector everywhere, and neighbours measure nearly the same
field. In the correct frame, vectors therefore scatter least, over the whole survey and between neighbours. Each known
mistake is undone in turn; if that leaves less scatter than the declared frame, the mistake was made. Hard iron
scatters even in the correct frame: if the Earth's field is visible beside a constant of the sensor, all candidates
are compared after subtracting their best constants.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from magmatch.data.order import has_order
from magmatch.data.survey import Survey
from magmatch.data.units import ORDINARY_FIELD, TESLA_PER_UNIT, FieldUnit, field_text, likely_field_unit
from magmatch.errors import in_short
from magmatch.geometry import path_walked
from magmatch.typing import Points, Scalars, Vector3, Vectors

log = logging.getLogger(__name__)

# Scatter with a mistake undone over that as declared, below which it was made: what is declared gets the benefit of a
# tenth. Recordings: 1.17 and more where all is right, 0.85 and less where a frame is wrong (walked headings: 0.93).
LESS = 0.9
# Of the variance of directions, each of length one: from here on they are rather scattered than alike.
HALF = 0.5
# Mean vector over mean norm: Earth's field keeps it near one in a frame that stands still.
TURNING = 0.5
N_ASKED, N_NEIGHBOURS = 1500, 9
# Steps of a path whose direction counts, m; shorter ones are sway.
STRIDE = 0.5
# Walked steps that a direction is told by.
MIN_STEPS = 10
OWN = "x, y, z"
# Smallest singular value over the largest from which on directions of constants are told apart.
DISTINCT = 1e-3

CONSTANT_FIELD = 1e-9  # T, standard deviation of every component
# Deg; indoors steel bends a place's mean field by some tens of them.
PLAUSIBLE_BEND = 35.0

# A field, and the orientations that turned it.
Turned = tuple[Vectors, Rotation]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One error of a survey."""

    # ``field frame``, ``orientations``, ``two frames``, ``heading``, ``turning``, ``vertical`` or ``magnitude``
    kind: str
    measured: str  # the evidence for it, and what to do
    remedy: str

    def __str__(self) -> str:
        return f"{self.measured}: {self.remedy}"

    @property
    def is_of_frames(self) -> bool:
        """Whether vectors are in a wrong frame, which no calibration of the sensor corrects."""
        return self.kind != "magnitude"


# Mistakes that the field shows, by what undoes them: kind, how vectors read where it was made, remedy.
MISTAKES = {
    "sensor": ("field frame", "those of a sensor that turns", "use --field-frame sensor (in Python field_frame)"),
    "survey": ("field frame", "turned once too often", "use --field-frame survey (in Python field_frame)"),
    "inverse": ("orientations", "turned the wrong way", "orientations take sensor to survey axes: invert them"),
    "scalar first": ("orientations", "turned by other quaternions", "the scalar comes last: rename qx, qy, qz, qw"),
    "scalar last": (
        "orientations",
        "turned by other quaternions",
        "the scalar came last in them: rename qx, qy, qz, qw",
    ),
    "heading": (
        "heading",
        "turned by a heading that is not the walked one",
        "check where the orientations come from",
    ),
    "carried": (
        "turning",
        "those of a sensor that turns as it is walked about",
        "if they are in its axes, use --field-frame sensor and give orientations",
    ),
}


def diagnose(survey: Survey, unit: FieldUnit = "T") -> list[Diagnosis]:
    """List the errors of a survey's frames and units; it passes `require_survey`, and was read in that unit."""
    return [*_of_magnitude(survey, unit), *_of_frames(survey)]


def constant_field(survey: Survey) -> str:
    """In words, that the field varies nowhere, in the survey's or in the sensor's axes; empty if it does."""
    read = survey.field if survey.orientations is None else survey.orientations.apply(survey.field, inverse=True)
    for field, where in ((survey.field, ""), (read, " in the sensor's axes")):
        if float(field.std(axis=0).max()) < CONSTANT_FIELD:
            least = field_text(CONSTANT_FIELD)
            return f"the field is constant{where} (varies less than {least}): nothing tells places apart"
    return ""


def of_verticals(base: Survey, target: Survey) -> list[Diagnosis]:
    """Whether two surveys of one place, with z up in both, have fields of contradictory inclination."""
    dips = [inclination_deg(survey.field.mean(axis=0)) for survey in (base, target)]
    if abs(dips[0] - dips[1]) <= PLAUSIBLE_BEND:
        return []
    measured = "the field dips {:.0f} deg below the base's horizontal and {:.0f} deg below the target's".format(*dips)
    return [Diagnosis("vertical", measured, "z is not up in one of them: correct its axes, or do not state gravity")]


def inclination_deg(vector: Vector3) -> float:
    """Angle below the horizontal of a vector with z up."""
    return float(np.degrees(np.arctan2(-vector[2], np.hypot(vector[0], vector[1]))))


def warn(surveys: Iterable[Survey]) -> list[Diagnosis]:
    """Log the errors of surveys, one warning of each kind; also returns them."""
    found = [(survey.name, one) for survey in surveys for one in diagnose(survey)]
    for kind in dict.fromkeys(one.kind for _, one in found):
        named = {name: one for name, one in found if one.kind == kind}
        log.warning("%s: %s", ", ".join(in_short([*named])), next(iter(named.values())))
    return [one for _, one in found]


def _of_magnitude(survey: Survey, unit: FieldUnit) -> Iterator[Diagnosis]:
    median = float(np.median(np.linalg.norm(survey.field, axis=1)))
    if not ORDINARY_FIELD[0] <= median <= ORDINARY_FIELD[1]:
        likely = likely_field_unit(median / TESLA_PER_UNIT[unit])
        remedy = f"if the file is in {likely}, use --field-unit {likely}" if likely else "a wrong unit, or a magnet?"
        measured = f"the median field magnitude is {field_text(median)}, unusual on Earth (about 50 uT)"
        yield Diagnosis("magnitude", measured, remedy)


def _of_frames(survey: Survey) -> Iterator[Diagnosis]:
    """Diagnose frames: rotated wrongly, the Earth's part of the field scatters; rotated correctly, it is constant."""
    walked, q, field = _Walked.of(survey), survey.orientations, survey.field
    own, heading, undone = 0.0, "", {} if q is None else _without_mistakes(field, q)
    if q is not None and walked is not None and (own := walked.variance(q, AXES[OWN])) >= HALF:
        turn, heading = walked.disagreement(q)
        undone["heading"] = turn.apply(field), turn * q
    elif q is None and walked is not None:
        q = Rotation.from_euler("z", walked.heading[:, None])
        undone["carried"] = q.apply(field), q
    mistake = None if q is None else _mistake_made(survey.positions, (field, q), undone)
    if mistake is not None:
        name, share = mistake
        kind, words, remedy = MISTAKES[name]
        measured = f"the field vectors look like {words}{heading if name == 'heading' else ''}"
        yield Diagnosis(kind, f"{measured} (with that undone they scatter {share:.0%} as much)", remedy)
    elif survey.orientations is None:
        if np.linalg.norm(field.mean(axis=0)) < TURNING * np.linalg.norm(field, axis=1).mean():
            measured = "the field vectors point every way, as those of a sensor do that turns"
            yield Diagnosis("turning", measured, MISTAKES["carried"][2])
    elif own >= HALF and walked is not None:
        spread, axes = min((walked.variance(survey.orientations, axes), name) for name, axes in AXES.items())
        if spread < HALF * own:
            words = f"the orientations' x, y, z look like the path's {axes}"
            measured = f"positions and orientations are in two frames: {words}"
            yield Diagnosis("two frames", measured, "give both in one frame")


def _mistake_made(points: Points, declared: Turned, undone: Mapping[str, Turned]) -> tuple[str, float] | None:
    """The mistake whose correction scatters least, and as what share of the declared; None if none does."""
    scatter, stands_still = _Scatter.of(points), _stands_still(*declared)
    if stands_still:
        # A constant of the sensor as large as Earth's field explains a field that is turned once too often.
        undone = {name: turned for name, turned in undone.items() if _stands_still(*turned)}
    for free_iron in (True,) if stands_still else (False, True):
        as_declared = scatter(*declared, free_iron=free_iron)
        tried = ((scatter(*turned, free_iron=free_iron), name) for name, turned in undone.items())
        least, name = min(tried, default=(as_declared, ""))
        if least < LESS * as_declared:
            return name, least / as_declared
    return None


def _stands_still(field: Vectors, q: Rotation) -> bool:
    """Whether a field like the Earth's is constant in the survey's frame, apart from a constant in the sensor's.

    Along what the sensor does not turn about; about that, the two cannot be told apart.
    """
    columns = q.as_matrix()
    both = np.concatenate([np.tile(np.eye(3), (len(field), 1)), columns.reshape(-1, 3)], axis=1)
    earth, kept = np.linalg.lstsq(both, field.ravel(), rcond=DISTINCT)[0][:3], columns.mean(axis=0)
    return bool(np.linalg.norm(earth - kept @ (kept.T @ earth)) > ORDINARY_FIELD[0])


def _without_mistakes(field: Vectors, q: Rotation) -> dict[str, Turned]:
    """The field in the survey frame, had each mistake been made, and what turned it."""
    read, numbers = q.apply(field, inverse=True), q.as_quat()
    first, last = (Rotation.from_quat(np.roll(numbers, k, axis=1)) for k in (-1, 1))
    return {
        "sensor": (q.apply(field), q),
        "survey": (read, q),
        "inverse": (q.apply(read, inverse=True), q.inv()),
        "scalar first": (first.apply(read), first),
        "scalar last": (last.apply(read), last),
    }


@dataclass(frozen=True, eq=False, slots=True)
class _Scatter:
    """Of vectors at given points: geometric mean of that over all and that between neighbours, T^2."""

    first: np.ndarray
    other: np.ndarray

    @classmethod
    def of(cls, points: Points) -> "_Scatter":
        rows = np.linspace(0, len(points) - 1, min(N_ASKED, len(points))).astype(np.int64)
        near = np.asarray(cKDTree(points[rows]).query(points[rows], k=min(N_NEIGHBOURS + 1, len(rows)))[1])[:, 1:]
        return cls(np.repeat(rows, near.shape[1]), rows[near.ravel()])

    def __call__(self, field: Vectors, q: Rotation, *, free_iron: bool) -> float:
        """Of a field and what turned it; where hard iron is free, without the best constant in the sensor's axes."""
        if free_iron:
            columns = q.as_matrix() - q.as_matrix().mean(axis=0)
            offset = field - field.mean(axis=0)
            field = field - q.apply(np.linalg.lstsq(columns.reshape(-1, 3), offset.ravel(), rcond=DISTINCT)[0])
        between = ((field[self.first] - field[self.other]) ** 2).sum(axis=1).mean()
        return float(np.sqrt(field.var(axis=0).sum() * between))


@dataclass(frozen=True, eq=False, slots=True)
class _Walked:
    """Where a path leads."""

    heading: Scalars  # (n,), rad: at each sample, about z
    rows: np.ndarray  # (k,): samples in the middle of strides
    direction: Vectors  # (k, 3): of each stride

    @classmethod
    def of(cls, survey: Survey) -> "_Walked | None":
        """None where rows are no path, or a short one."""
        if not has_order(survey):
            return None
        walked, points = path_walked(survey.positions), survey.positions
        stride = max(STRIDE, float(np.median(np.diff(walked))))
        ends = np.unique(np.searchsorted(walked, np.arange(0, walked[-1], stride)))
        strides = np.diff(points[ends], axis=0)
        length = np.linalg.norm(strides, axis=1)
        kept = (length > stride / 2) & (length < 2 * stride)
        if kept.sum() < MIN_STEPS:
            return None
        rows, strides = ((ends[:-1] + ends[1:]) // 2)[kept], strides[kept] / length[kept, None]
        angle = np.unwrap(np.arctan2(strides[:, 1], strides[:, 0]))
        heading = np.interp(np.arange(len(survey)), rows, angle)
        return cls(heading, rows, strides)

    def seen_by(self, orientations: Rotation, axes: np.ndarray) -> Vectors:
        """Directions in the sensor's axes, were the orientations in these axes of the path."""
        return np.asarray(orientations[self.rows].apply(self.direction @ axes.T, inverse=True))

    def variance(self, orientations: Rotation, axes: np.ndarray) -> float:
        """Of directions so seen: 0 where all are alike, as of a sensor that is carried along; 1 where they cancel."""
        return 1.0 - float((self.seen_by(orientations, axes).mean(axis=0) ** 2).sum())

    def disagreement(self, orientations: Rotation) -> tuple[Rotation, str]:
        """Turns about z that make the sensor head where it is carried; the spread and offset in words."""
        mean = self.seen_by(orientations, np.eye(3)).mean(axis=0)
        forward = orientations.apply(mean)
        turn = self.heading - np.arctan2(forward[:, 1], forward[:, 0])
        spread = np.degrees(np.sqrt(-np.log(max(mean @ mean, np.finfo(float).tiny))))
        offset = np.degrees(np.arctan2(mean[1], mean[0]))
        words = f", spread {spread:.0f} deg about an offset of {offset:.0f} deg from the sensor's x"
        return Rotation.from_euler("z", turn[:, None]), words


def _named(axes: np.ndarray) -> str:
    """Which axes the rows are, such as ``-y, x, z``."""
    return ", ".join(f"{'-' * int(row.min() < 0)}{'xyz'[np.abs(row).argmax()]}" for row in axes)


# The 24 permutations and signs of the axes that stay right-handed.
AXES = {_named(axes): axes for axes in np.rint(Rotation.create_group("O").as_matrix())}
