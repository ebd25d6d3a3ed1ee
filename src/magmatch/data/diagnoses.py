# SPDX-License-Identifier: BSD-3-Clause
"""Errors in a survey's frames and units that the survey itself reveals: kind, measurement, remedy.

One principle: the Earth's part of the field is the same vector everywhere, and neighbours measure nearly the same
field. In the correct frame, vectors therefore scatter least, over the whole survey and between neighbours. Each known
mistake is undone in turn (`magmatch.data.frame_mistakes`). One that leaves less scatter than what is declared, and
than all others, in the whole and in each third, was made; if the motion does not tell several apart, what they share
is said.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.frame_mistakes import (
    AXES,
    DECLARED,
    LESS,
    OWN,
    Found,
    FrameMistake,
    Turned,
    lag_instead,
    mistake_made,
    named,
)
from magmatch.data.geodesy import Origin
from magmatch.data.sensor_axes import FEW, HALF, RESOLVED, is_constant, sensor_readings
from magmatch.data.survey import Survey, has_order
from magmatch.data.survey_columns import origin_of
from magmatch.data.units import TESLA_PER_UNIT, FieldUnit, field_text, likely_field_unit, unusual_size
from magmatch.errors import in_short
from magmatch.geometry import path_walked
from magmatch.typing import Scalars, Vector3, Vectors

log = logging.getLogger(__name__)

# Steps of a path whose direction counts, m; shorter ones are sway.
STRIDE = 0.5
# Ways of the axes that are listed where the motion does not tell which it is; more help nobody.
MOST_WAYS = 4

# Deg; indoors steel bends a place's mean field by some tens of them.
PLAUSIBLE_BEND = 35.0
# Deg of latitude beyond which the Earth's field points down in the north and up in the south, all around the globe.
SURE_LATITUDE = 20.0


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One error of a survey."""

    # ``field frame``, ``orientations``, ``axes``, ``two frames``, ``heading``, ``turning``, ``vertical``,
    # ``clocks``, ``latitude`` or ``magnitude``
    kind: str
    measured: str  # the evidence for it, and what to do
    remedy: str

    def __str__(self) -> str:
        return f"{self.measured}: {self.remedy}"

    @property
    def is_of_frames(self) -> bool:
        """Whether vectors are in a wrong frame, which no calibration of the sensor corrects."""
        # Hard iron may turn a field upside down, too.
        return self.kind not in {"magnitude", "clocks", "latitude"}


# Mistakes that the field shows, by what undoes them: kind, how vectors read where it was made, remedy.
MISTAKES = {
    DECLARED: ("axes", "those of a sensor whose axes are swapped, reversed or mounted turned", ""),
    "sensor": ("field frame", "those of a sensor that turns", "use --field-frame sensor (in Python field_frame)"),
    "survey": ("field frame", "turned once too often", "use --field-frame survey (in Python field_frame)"),
    "inverse": ("orientations", "turned the wrong way", "orientations take sensor to survey axes: invert them"),
    "scalar first": ("orientations", "turned by other quaternions",
                     "the scalar comes last: rename qx, qy, qz, qw, or put '# t x y z qw qx qy qz' above poses "
                     "without names"),
    "scalar last": ("orientations", "turned by other quaternions",
                    "the scalar came last in them: rename qx, qy, qz, qw"),
    "heading": ("heading", "turned by a heading that is not the walked one",
                "check where the orientations come from"),
    "carried": ("turning", "those of a sensor that turns as it is walked about",
                "if they are in its axes, use --field-frame sensor and give orientations"),
}  # fmt: skip


def diagnose(survey: Survey, unit: FieldUnit = "T") -> list[Diagnosis]:
    """List the errors of a survey's frames and units; it passes `require_survey`, and was read in that unit."""
    # An offset of the sensor may point anywhere, and a wrong frame up or down.
    return [*of_magnitude(survey, unit), *_of_frames(survey)] or [*_of_latitude(survey)]


def constant_field(survey: Survey) -> str:
    """Say that the field varies nowhere, in the survey's or in the sensor's axes; nothing if it does."""
    for field, where in ((survey.field, ""), (sensor_readings(survey), " in the sensor's axes")):
        if is_constant(field):
            least = field_text(RESOLVED)
            return f"the field is constant{where} (varies less than {least}): nothing tells places apart"
    return ""


def of_verticals(base: Survey, target: Survey, *, names: tuple[str, str] = ("base", "target")) -> list[Diagnosis]:
    """Whether two surveys of one place, with z up in both, have fields of contradictory inclination."""
    dips = [inclination_deg(survey.field.mean(axis=0)) for survey in (base, target)]
    if abs(dips[0] - dips[1]) <= PLAUSIBLE_BEND:
        return []
    one, other = (f"{dip:.0f} deg below the {name}'s" for dip, name in zip(dips, names, strict=True))
    remedy = (
        "z is not up in one of them: correct its axes, or do not take it for up (localize, slam: --no-gravity; "
        "register: neither --gravity-aligned nor --planar)"
    )
    return [Diagnosis("vertical", f"the field dips {one} horizontal and {other}", remedy)]


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


def of_magnitude(survey: Survey, unit: FieldUnit) -> Iterator[Diagnosis]:
    """Whether a field, read in that unit, is of another size than near the Earth's surface."""
    median = float(np.median(np.linalg.norm(survey.field, axis=1)))
    if measured := unusual_size(median):
        likely = likely_field_unit(median / TESLA_PER_UNIT[unit])
        remedy = "a wrong unit, or a magnet?"
        if likely:
            remedy = f"if the file is in {likely}, use --field-unit {likely}; else the sensor has an offset"
        yield Diagnosis("magnitude", measured, remedy)


def _of_latitude(survey: Survey) -> Iterator[Diagnosis]:
    """Diagnose a field that points up where the Earth's points down, or down where it points up."""
    if (origin := origin_of(survey.frame)) is None:
        return
    latitude, dip = Origin.of(origin).latitude_deg, inclination_deg(survey.field.mean(axis=0))
    if abs(latitude) > SURE_LATITUDE and -dip * np.sign(latitude) > PLAUSIBLE_BEND:
        ways = ("down", "up") if latitude > 0 else ("up", "down")
        measured = (
            f"the field points {ways[1]} by {abs(dip):.0f} deg, expected {ways[0]} at a latitude of {latitude:.0f}"
        )
        remedy = "vectors in axes north, east, down? --columns bx=by,by=bx,bz=-bz makes them east, north, up"
        yield Diagnosis("latitude", measured, remedy)


def _of_frames(survey: Survey) -> Iterator[Diagnosis]:
    """Diagnose frames: rotated wrongly, the Earth's part of the field scatters; rotated correctly, it is constant."""
    walked, q, field = _Walked.of(survey), survey.orientations, survey.field
    own, heading, conventions = 0.0, "", {} if q is None else _conventions(field, q)
    if q is not None and walked is not None and (own := walked.variance(q, AXES[OWN])) >= HALF:
        turn, heading = walked.disagreement(q)
        conventions["heading"] = Turned(q.apply(field, inverse=True), turn * q, turn * q)
    elif q is None and walked is not None:
        q = Rotation.from_euler("z", walked.heading[:, None])
        conventions = {DECLARED: Turned(field, None, q), "carried": Turned(field, q, q)}
    found = mistake_made(survey.positions, conventions) if conventions else None
    lag = None if found is None else lag_instead(survey.positions, conventions[DECLARED], survey.times, found)
    if lag is not None:
        behind = "late" if lag > 0 else "early"
        measured = f"the field vectors look about {abs(lag):.1g} s {behind} against the poses"
        yield Diagnosis("clocks", measured, "magmatch prepare estimates the offset of the clocks")
    elif found is not None:
        yield _told(found, conventions, heading)
    elif survey.orientations is None:
        # Earth's field keeps it near one in a frame that stands still.
        if np.linalg.norm(field.mean(axis=0)) < HALF * np.linalg.norm(field, axis=1).mean():
            measured = "the field vectors point every way, as those of a sensor do that turns"
            yield Diagnosis("turning", measured, MISTAKES["carried"][2])
    elif own >= HALF and walked is not None:
        yield from _of_two_frames(walked, survey.orientations, own)


def _of_two_frames(walked: "_Walked", orientations: Rotation, own: float) -> Iterator[Diagnosis]:
    """Whether the path's directions are alike in the sensor's axes once the path's axes are others."""
    spreads = {name: walked.variance(orientations, axes) for name, axes in AXES.items()}
    least = min(spreads.values())
    if least < HALF * own:
        alike = [name for name, spread in spreads.items() if LESS * spread <= least]
        words = f": the orientations' x, y, z look like the path's {alike[0]}" if len(alike) == 1 else ""
        yield Diagnosis(
            "two frames", f"positions and orientations are in two frames{words}", "give both in one frame"
        )


def _conventions(field: Vectors, q: Rotation) -> dict[str, Turned]:
    """List readings, and what turns them, as declared and had each mistake been made."""
    read, numbers = q.apply(field, inverse=True), q.as_quat()
    first, last = (Rotation.from_quat(np.roll(numbers, k, axis=1)) for k in (-1, 1))
    return {
        DECLARED: Turned(read, q, q, any_axes=True),
        "sensor": Turned(field, q, q, any_axes=True),
        "survey": Turned(read, None, q),
        "inverse": Turned(read, q.inv(), q.inv(), any_axes=True),
        "scalar first": Turned(read, first, first, any_axes=True),
        "scalar last": Turned(read, last, last, any_axes=True),
    }


def _told(found: Found, conventions: Mapping[str, Turned], heading: str) -> Diagnosis:
    """Say what was found, and as much of the remedy as is certain."""
    undone = f"(with that undone they scatter {found.share:.0%} as much)"
    if found.mount is not None:
        turn = np.degrees(found.mount.magnitude())
        measured = f"the field vectors look like those of a sensor mounted turned by {turn:.0f} deg {undone}"
        up = inclination_deg(conventions[DECLARED].mean(found.mount.as_matrix())) < -PLAUSIBLE_BEND
        also = "; where the field points down, its axes are reversed, too" if up else ""
        return Diagnosis("axes", measured, f"state how it is mounted: {_extrinsic(found.mount)}{also}")
    first, name = found.hypotheses[0], found.hypotheses[0].convention
    if any(one.convention != name for one in found.hypotheses):
        measured = f"the field vectors look turned otherwise than declared {undone}"
        remedy = "the motion does not tell how: check the sensor's axes, its mount (--extrinsic) and the orientations"
        return Diagnosis("axes", measured, remedy)
    kind, words, remedy = MISTAKES[name]
    if first.axes == OWN:
        measured = f"the field vectors look like {words}{heading if name == 'heading' else ''} {undone}"
        return Diagnosis(kind, measured, remedy)
    also = "" if name == DECLARED else f"{words}, and "
    measured = f"the field vectors look like {also}{MISTAKES[DECLARED][1]} {undone}"
    also = "" if name == DECLARED else f"{remedy}; "
    return Diagnosis(kind, measured, also + _of_axes(found.hypotheses, conventions[name]))


def _of_axes(alike: tuple[FrameMistake, ...], read: Turned) -> str:
    """Say how to read the axes; which way the field points along z tells the sign that scatter does not."""
    if len(alike) > MOST_WAYS:
        return "the motion does not tell which way: state how the sensor is mounted (--extrinsic)"
    # All axes are reversed where the field would point up steeply, as it does in few of the places surveyed.
    points_up = (inclination_deg(read.mean(AXES[one.axes])) < -PLAUSIBLE_BEND for one in alike)
    ways = [-AXES[one.axes] if is_up else AXES[one.axes] for one, is_up in zip(alike, points_up, strict=True)]
    listed = " or ".join(f"({named(axes)})" for axes in ways)
    theirs = [way.replace(way[-1], f"b{way[-1]}") for way in named(ways[0]).split(", ")]  # such as -by
    options = "--columns " + ",".join(f"b{x}={way}" for x, way in zip("xyz", theirs, strict=True))
    if len(ways) > 1:
        options = (
            "the motion does not tell which, its data sheet or mount does (--columns with a minus, or --extrinsic)"
        )
    elif np.linalg.det(ways[0]) > 0:
        options = f"{_extrinsic(Rotation.from_matrix(ways[0]))} or {options}"
    also = "; where the field points up along z, as south of the magnetic equator, all three signs are reversed"
    return f"x, y, z are {listed} of what is read: {options}{also}"


def _extrinsic(turn: Rotation) -> str:
    """The option that states a mount."""
    return f"--extrinsic '0 0 0 {' '.join(f'{v:.4f}' for v in turn.as_quat(canonical=True) + 0.0)}'"


@dataclass(frozen=True, eq=False, slots=True)
class _Walked:
    """Say where a path leads."""

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
        if kept.sum() < FEW:
            return None
        rows, strides = ((ends[:-1] + ends[1:]) // 2)[kept], strides[kept] / length[kept, None]
        angle = np.unwrap(np.arctan2(strides[:, 1], strides[:, 0]))
        heading = np.interp(np.arange(len(survey)), rows, angle)
        return cls(heading, rows, strides)

    def seen_by(self, orientations: Rotation, axes: np.ndarray) -> Vectors:
        """Directions in the sensor's axes, were the orientations in these axes of the path."""
        return np.asarray(orientations[self.rows].apply(self.direction @ axes.T, inverse=True))

    def variance(self, orientations: Rotation, axes: np.ndarray) -> float:
        """Give the spread of directions so seen: 0 where all are alike (a carried sensor), 1 where they cancel."""
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
