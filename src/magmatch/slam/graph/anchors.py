# SPDX-License-Identifier: BSD-3-Clause
"""Fixed points: known positions of a log at given times, in a surveyor's frame."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np

from magmatch.arguments import column_of, expect_kind, number_of, numbers_of
from magmatch.compiled import NOTICE
from magmatch.data.geodesy import Origin, local_east_north, what_is_wrong
from magmatch.data.survey import Survey
from magmatch.data.surveyed_points import SurveyedPoints, mirrored_misfits
from magmatch.data.tables.table import Wanted, read_table
from magmatch.data.tables.text_rows import listed
from magmatch.data.units import CLOCKS_APART
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.number_text import told
from magmatch.slam.graph.factors import FixedPoints
from magmatch.slam.graph.trajectories import around
from magmatch.slam.windows import Path
from magmatch.typing import Vector3

logger = logging.getLogger(__name__)

NUMBERS = ("t", "x", "y", "z", "sd")
COLUMNS = ("log", *NUMBERS)
DEGREES = {"x": "lat", "y": "lon"}  # columns that stand in for others
# Per axis, m: people who walk at 1 m/s press the button within some tenths of a second of the point.
WAYPOINT_SD = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class Anchor:
    """A fixed point that a log passed.

    Attributes
    ----------
    log : str
        Name of the log, with its ending or without.
    t : float, s
        On the log's own clock.
    position : (3,) array, m
        In the surveyor's frame; with `in_degrees`: latitude and longitude (deg), and z.
    sd : float, m
        Standard deviation of each coordinate, above 0.
    source : str
        File and line, for messages.
    """

    log: str
    t: float
    position: Vector3
    sd: float
    source: str = "anchor"
    in_degrees: bool = False

    def __post_init__(self) -> None:
        column_of([self.t], f"{self.source}: t", "s", 1)
        number_of(self.sd, f"{self.source}: sd", "m", is_positive=True)
        position = numbers_of(self.position, f"{self.source}: position", "(3,)")
        if position.shape != (3,) or not np.isfinite(position).all():
            msg = f"{self.source}: position: expected three finite numbers (m), got {self.position!r:.60}"
            raise ValueError(msg)
        if self.in_degrees and (wrong := what_is_wrong(position[:1], position[1:2])):
            msg = f"{self.source}: position: {wrong}"
            raise ValueError(msg)
        object.__setattr__(self, "position", position)

    def local(self, origin: Origin) -> "Anchor":
        """Express the point in metres east and north of an origin."""
        latitude, longitude, z = self.position
        ((east, north),) = local_east_north(np.array([latitude]), np.array([longitude]), origin)
        return replace(self, position=np.array([east, north, z]), in_degrees=False)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Time, coordinates and standard deviation, as `NUMBERS` names them."""
        return (self.t, *self.position.tolist(), self.sd)


def read_anchors(path: str | FilePath) -> list[Anchor]:
    """Read fixed points from a table with the columns ``log,t,x,y,z,sd`` (s and m), or ``lat,lon`` (deg) for x, y.

    Raises
    ------
    DataFormatError
        The file is no such table; the message says line and column.
    """
    table = read_table(path, Wanted((*NUMBERS, *DEGREES.values()), words=("log",)))
    in_degrees = not table.has(*DEGREES) and table.has(*DEGREES.values())
    names = [DEGREES.get(name, name) if in_degrees else name for name in NUMBERS]
    missing = [name for name in ("log", *names) if name not in table.names]
    if missing:
        columns = f"{', '.join(COLUMNS)} (or {', '.join(DEGREES.values())} for x, y)"
        message = f"expected columns {columns}; missing {', '.join(missing)}; found {listed(table.names)}"
        raise DataFormatError(path, message)
    numbers, lines = table.stack(*names), table.line_numbers.tolist()
    for line, (_, x, y, _, sd) in zip(lines, numbers, strict=True):
        if in_degrees and (wrong := what_is_wrong(np.array([x]), np.array([y]))):
            raise DataFormatError(path, wrong, line=line)
        if sd <= 0:
            message = f"expected a standard deviation above 0 m, found {told(sd)}"
            raise DataFormatError(path, message, line=line, column="sd")
    return [
        Anchor(log, float(n[0]), n[1:4], float(n[4]), f"{path}, line {line}", in_degrees)
        for line, log, n in zip(lines, table.words["log"], numbers, strict=True)
    ]


def in_metres(
    anchors: Sequence[Anchor], origin: tuple[float, float] | None, earlier: Sequence[Anchor] = ()
) -> tuple[list[Anchor], tuple[float, float] | None]:
    """Convert fixed points in degrees to metres east and north of an origin, given too: by default the first point.

    Points in metres, ``earlier`` ones too, have a frame that nothing ties to degrees, unless the origin is stated.
    """
    in_degrees = [a for a in anchors if a.in_degrees]
    if not in_degrees:
        return list(anchors), origin
    other = next((a for a in (*earlier, *anchors) if not a.in_degrees), None)
    if origin is None and other is not None:
        msg = (
            f"{other.source}: is in metres, {in_degrees[0].source} in degrees, expected all in one frame; state the "
            "latitude and longitude at which x and y are 0 (setting 'origin'), or leave some out"
        )
        raise ConfigurationError(msg)
    latitude, longitude = origin or in_degrees[0].position[:2].tolist()
    at = Origin(latitude, longitude)
    return [a.local(at) if a.in_degrees else a for a in anchors], (latitude, longitude)


def points_passed(
    anchors: Sequence[Anchor] | str | FilePath,
    logs: Sequence[Survey],
    names: Sequence[str],
    n_known: int,
    earlier: Sequence[tuple[Anchor, int]],
    origin: tuple[float, float] | None,
    *,
    waypoints: bool,
) -> tuple[list[tuple[Anchor, int]], tuple[float, float] | None]:
    """New fixed points in metres, each with the log that passed it, and the origin of their frame in degrees.

    They are those of a table or a list, and with ``waypoints`` those that logs after the first ``n_known`` hold
    themselves. The ``earlier`` ones may be given again.
    """
    found = read_anchors(anchors) if isinstance(anchors, str | FilePath) else list(anchors)
    for k, anchor in enumerate(found):
        expect_kind(anchor, f"anchors[{k}]", (Anchor,), "give a magmatch.Anchor")
    before = [anchor for anchor, _ in earlier]
    if waypoints:
        is_tied = origin is not None or all(anchor.in_degrees for anchor in (*found, *before))
        found += waypoints_of(logs[n_known:], names[n_known:], is_tied=is_tied)
    found, origin = in_metres(found, origin, before)
    known = {(of, anchor.numbers) for anchor, of in earlier}
    spans = [None if s.times is None else (float(s.times[0]), float(s.times[-1])) for s in logs]
    passed = of_named(found, [survey.name for survey in logs], names, spans)
    fixed = [(anchor, of) for anchor, of in passed if (of, anchor.numbers) not in known]
    warn_of_a_mirrored_plan(fixed, logs)
    return fixed, origin


def of_named(
    anchors: Sequence[Anchor], files: Sequence[str], names: Sequence[str], spans: Sequence[tuple[float, float] | None]
) -> list[tuple[Anchor, int]]:
    """Fixed points with the log that passed each; logs are given as files' names, their own, and their spans in s."""
    known, found = [{name, file, FilePath(file).name} for name, file in zip(names, files, strict=True)], []
    for anchor in anchors:
        of = next((k for k, some in enumerate(known) if anchor.log in some), None)
        if of is None:
            msg = f"{anchor.source}: expected the name of a log ({', '.join(names)}), found {anchor.log!r}"
            raise ConfigurationError(msg)
        span = spans[of]
        if span is None:
            msg = f"{anchor.source}: log {anchor.log!r} has no times, which a fixed point needs"
            raise ConfigurationError(msg)
        if not span[0] - CLOCKS_APART <= anchor.t <= span[1] + CLOCKS_APART:
            between = f"between {told(span[0])} and {told(span[1])} s, when log {anchor.log!r} was walked"
            msg = (
                f"{anchor.source}: expected a time {between} ({CLOCKS_APART:g} s more counts), found {told(anchor.t)}"
            )
            raise ConfigurationError(msg)
        found.append((anchor, of))
    return found


def warn_of_a_mirrored_plan(passed: Sequence[tuple[Anchor, int]], logs: Sequence[Survey]) -> None:
    """Say so where only the mirror image of a log's fixed points, in metres, fits its path."""
    for of, survey in enumerate(logs):
        own = [anchor for anchor, log in passed if log == of]
        if not own or survey.times is None:
            continue
        at = [anchor.t for anchor in own]
        walked = np.column_stack([np.interp(at, survey.times, axis) for axis in survey.positions.T[:2]])
        found = mirrored_misfits(np.array([anchor.position[:2] for anchor in own]), walked)
        if found is not None:
            fit = "fit its path mirrored (%.2g m off, rms), not as given (%.2g m)"
            words = f"the fixed points of %s {fit}: y counted downward, or x and y swapped?"
            logger.warning(words, survey.name, found[1], found[0])


def fixed_points(anchors: Sequence[tuple[Anchor, int]], paths: Sequence[Path]) -> FixedPoints:
    """Fixed points as factors of the two nodes around each."""
    rows = []
    for anchor, log in anchors:
        path, times = paths[log], paths[log].survey.times
        assert times is not None
        (one,), (other,), (share,) = around(path, np.interp([anchor.t], times, path.walked))
        x = [np.interp(anchor.t, times, axis) for axis in path.survey.positions.T]
        # The log may have moved on between the point and the first or last sample.
        beyond = abs(anchor.t - np.clip(anchor.t, times[0], times[-1]))
        sd = np.hypot(anchor.sd, beyond * path.walked[-1] / (times[-1] - times[0]))
        rows.append((path.first_node + one, path.first_node + other, share, x, anchor.position, sd))
    return FixedPoints(*map(np.array, zip(*rows, strict=True)))


def waypoints(points: SurveyedPoints, survey: Survey, log: str) -> list[Anchor]:
    """Points of one log as its fixed points; those that it has no samples near are left out, which is logged.

    A plan says nothing of heights: each point lies as high as odometry has the log there.
    """
    times = survey.times
    assert times is not None  # what phones log has times
    is_passed = (points.times >= times[0] - CLOCKS_APART) & (points.times <= times[-1] + CLOCKS_APART)
    if not is_passed.all():
        words = "%s: %d of its %d surveyed points lie more than %g s before or after its samples (left out)"
        logger.warning(words, survey.name, (~is_passed).sum(), len(is_passed), CLOCKS_APART)
    heights = np.interp(points.times, times, survey.positions[:, 2])
    rows = zip(points.times, points.places, heights, points.lines, is_passed, strict=True)
    return [
        Anchor(log, float(t), np.array([x, y, z]), WAYPOINT_SD, f"{survey.name}, line {line}", points.in_degrees)
        for t, (x, y), z, line, counts in rows
        if counts
    ]


def waypoints_of(logs: Sequence[Survey], names: Sequence[str], *, is_tied: bool) -> list[Anchor]:
    """Points that logs hold themselves, as fixed points; those in degrees only if they are tied to the others."""
    marked = [(log.waypoints, log, name) for log, name in zip(logs, names, strict=True) if log.waypoints is not None]
    floors = sorted({floor for points, *_ in marked for floor in points.floors})
    if len(floors) > 1:  # dead reckoning does not know their heights
        words = "surveyed points lie on floors %s, and are taken as of one: give the logs of one floor alone"
        logger.warning(words, ", ".join(floors))
    found = [anchor for one in marked for anchor in waypoints(*one)]
    kept = [anchor for anchor in found if is_tied or not anchor.in_degrees]
    if len(kept) < len(found):
        words = "fixed points given in metres: points in degrees that logs hold are not used"
        logger.warning("%s; state where x and y are 0 (setting 'origin': latitude, longitude) to use both", words)
    if kept:
        logger.log(
            NOTICE, "%d surveyed points that logs hold are fixed points (--no-waypoints leaves them out)", len(kept)
        )
    return kept
