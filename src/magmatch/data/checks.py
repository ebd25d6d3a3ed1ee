# SPDX-License-Identifier: BSD-3-Clause
"""Checks of a survey: impossible ones are refused, suspicious ones are reported."""

import logging
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from magmatch.arguments import expect_kind
from magmatch.data.dataframes import SINCE_1970
from magmatch.data.diagnoses import constant_field, diagnose
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.sensor_axes import FEW, HALF, LONG, RESOLVED, doubt_axes, find_repeats, sensor_readings
from magmatch.data.survey import Survey, has_order
from magmatch.data.survey_columns import GLOBAL_FRAME, origin_of
from magmatch.data.units import TESLA_PER_UNIT, UNITS_PER_SECOND, LengthUnit, TimeUnit, field_text, likely_field_unit
from magmatch.errors import SurveyError, in_short
from magmatch.geometry import path_walked, typical_step
from magmatch.number_text import many, told
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# Fewer samples cannot fix a transform (6 unknowns) together with a field.
MIN_SAMPLES = FEW
# The Earth's field is 22 to 67 uT; shielded rooms reach some nT, a table over strong magnets some mT. A median
# outside these bounds is a unit, not a field.
MEDIAN_FIELD = (RESOLVED, 20e-3)
# Single samples may come close to a magnet; beyond this no survey magnetometer measures.
MAX_FIELD = 0.1
MAX_EXTENT = 100e3  # m; farther apart is no place that one survey covers
ODD_EXTENT = (0.01, 1e3)  # m; outside, millimetres, degrees or projected coordinates are likelier
ODD_SPEED = 50.0  # m/s, median along the samples
JUMP = 20.0  # median steps: one that is longer, and faster than that, is no step
USUAL_HOLD = 0.99  # of readings, counted once each, this share are held no longer than is usual
FLAT = 1e-3  # m, and the same as a fraction of the longest axis: no wider than this is a plane or a line
DAY, FASTEST = 86_400.0, 1e-4  # s; no survey magnetometer samples so fast
# Share of a number by which seconds that were made of it, and back, may differ.
ROUNDING_OF_TIMES = 1e-12
RAREST = 100.0  # s; samples are no farther apart
SLOW = (2.0, 0.005)  # s between samples and m/s: nobody walks like that, and few stop as long
TO_AND_FRO = 4.0  # of noise it is 1, along a path less
ONWARD = 1.5  # steps along a path; of samples listed to and fro, as height by height, two steps are none
GAP = (1.0, 10.0)  # s, and multiples of the median interval: an interval above both is a gap


# What to do about that which is no survey, by what it is.
ADVICE = {
    "path": "read_survey reads a survey from a file, FieldMap.load a saved map, open_atlas a folder of them",
    "DataFrame": "Survey.from_dataframe makes one of it",
    "Dataset": "Survey.from_xarray makes one of it",
    "array": "Survey(positions, field) makes one of arrays",
    "list of Survey": "build_map makes one map of several",
    "FieldMap": "its samples are in .survey",
    "Recording": "its samples are in .survey()",
    "": "read_survey reads one from a file",
}


def check_survey(survey: Survey, layout: SurveyFormat | None = None, *, is_unit_known: bool = False) -> list[str]:
    """Raise an error for an impossible survey; otherwise list what is suspicious about it.

    Of a field whose unit is known the size is not doubted.
    """
    require_survey(survey, layout)
    layout = layout or SurveyFormat()
    return [
        *(str(one) for one in diagnose(survey, layout.field_unit) if not (is_unit_known and one.kind == "magnitude")),
        *_doubt_field(survey),
        *_doubt_extent(survey, layout.length_unit),
        *_doubt_jumps(survey),
        *_doubt_shape(survey),
        *_doubt_repeats(survey),
        *_doubt_times(survey, layout.time_unit),
    ]


def require_walk(survey: Survey) -> None:
    """Refuse what is no walk by odometry."""
    require_survey(survey, name="log")
    who = survey.name or "log"
    if not has_order(survey):
        msg = f"{who}: its samples follow no path, expected a walk by odometry; for rigid surveys use merge"
        raise SurveyError(msg)
    if words := odd_speed(survey):
        msg = f"{who}: {words}"
        raise SurveyError(msg)


def require_survey(survey: Any, layout: SurveyFormat | None = None, name: str = "survey") -> None:
    """Raise an error for an impossible survey, from a file (read with the given layout) or from a caller."""
    expect_kind(survey, name, (Survey,), ADVICE)
    if len(survey) < MIN_SAMPLES:
        raise _refuse(survey, f"expected at least {MIN_SAMPLES} samples, found {len(survey)}")
    require_part(survey, layout)
    _require_possible_extent(survey, layout)


def require_part(survey: Any, layout: SurveyFormat | None = None) -> None:
    """Refuse what cannot be a part of a survey: of few samples, or even one."""
    expect_kind(survey, "survey", (Survey,), ADVICE)
    survey.check()
    if len(survey):
        _require_possible_field(survey, layout)


def require_one_frame(surveys: Sequence[Survey]) -> None:
    """Refuse surveys for one map whose positions are about different origins on the globe."""
    frames = list(dict.fromkeys(s.frame for s in surveys if s.frame.startswith(GLOBAL_FRAME)))
    if len(frames) > 1:
        origin = frames[0].removeprefix(GLOBAL_FRAME)
        same = f"read all with --origin {origin}, or have slam set 'origin: [{origin}]' (--config)"
        msg = f"expected surveys in one frame, found {frames[0]!r} and {frames[1]!r}; {same}"
        raise SurveyError(msg)
    others = [s.name for s in surveys if s.frame not in frames]
    if frames and others:
        words = "%s: taken to be in metres about %s, as another survey states; its own frame is no such one"
        log.warning(words, ", ".join(in_short(others)), frames[0].removeprefix(GLOBAL_FRAME))


def too_large(size: float) -> str:
    """Say that a sample's field, of some size in T, is none that a magnetometer reads."""
    return f"field: expected at most {MAX_FIELD:g} T, got {size:.3g}; if it is in uT, multiply by 1e-6"


def extent(survey: Survey) -> Scalars:
    """Size of the samples' box along each axis: (3,), m."""
    return np.asarray(np.ptp(survey.positions, axis=0))


def time_gaps(survey: Survey) -> Scalars:
    """Intervals between samples that are gaps, s; empty where there is no time."""
    if survey.times is None or len(survey) < 2:
        return np.zeros(0)
    intervals = np.diff(survey.times)
    return intervals[intervals > max(GAP[0], GAP[1] * float(np.median(intervals)))]


def _refuse(survey: Survey, message: str) -> SurveyError:
    return SurveyError(f"{survey.name}: {message}")


def _require_possible_field(survey: Survey, layout: SurveyFormat | None) -> None:
    with np.errstate(over="ignore"):  # absurd numbers become infinite, and are refused as such
        magnitude = np.linalg.norm(survey.field, axis=1)
    median = float(np.median(magnitude))
    low, high = MEDIAN_FIELD
    if not low <= median <= high:
        if not magnitude.any():
            raise _refuse(survey, "every field value is zero: a dead sensor, or the wrong columns")
        expected = f"{field_text(low)} to {field_text(high)} (the Earth's field is about 50 uT)"
        message = f"the median field magnitude is {field_text(median)}, expected {expected}"
        raise _refuse(survey, f"{message}; {_unit_advice(median, layout)}")
    worst = int(np.argmax(magnitude))
    if magnitude[worst] > MAX_FIELD:
        found = field_text(magnitude[worst])
        most = f"{field_text(MAX_FIELD)} (the median here is {field_text(median)})"
        raise _refuse(survey, f"the field of sample {worst} is {found}, expected at most {most}; remove such spikes")


def _unit_advice(median: float, layout: SurveyFormat | None) -> str:
    """Say which unit would make the numbers ordinary."""
    if layout is None:
        unit = likely_field_unit(median)
        tesla = 1.0 if unit is None else TESLA_PER_UNIT[unit]
        return f"if the numbers are in {unit}, multiply them by {tesla:g}" if unit else "wrong columns?"
    number = median / TESLA_PER_UNIT[layout.field_unit]
    unit = likely_field_unit(number)
    if unit is None:
        return f"read as {layout.field_unit}, and no other known unit makes it ordinary: wrong columns?"
    advice = f"if the file is in {unit}, use --field-unit {unit} (files that differ: first 'magmatch convert' one)"
    return f"read as {layout.field_unit}; {advice}"


def _require_possible_extent(survey: Survey, layout: SurveyFormat | None) -> None:
    with np.errstate(over="ignore"):
        size = float(extent(survey).max())
    if size > MAX_EXTENT:
        advice = "if the numbers are in mm or cm, divide them by 1000 or 100"
        if survey.frame.startswith(GLOBAL_FRAME):
            advice = "rows without a fix (latitude and longitude 0), or several places? leave such rows out"
        elif layout is not None:
            advice = f"read as {layout.length_unit}; if the file is in mm or cm, use --length-unit mm (or cm)"
        message = f"the positions span {size / 1e3:.4g} km, expected less than {MAX_EXTENT / 1e3:g} km; {advice}"
        raise _refuse(survey, message)
    origin = origin_of(survey.frame)
    nearest = 0.0 if origin is None else float(np.linalg.norm(survey.positions, axis=1).min())
    if nearest > MAX_EXTENT:
        message = f"the nearest sample lies {nearest / 1e3:.4g} km from the origin {origin}, too far for one horizon"
        raise _refuse(survey, f"{message}; latitude and longitude swapped (--origin)?")
    if size == 0:
        raise _refuse(survey, "all samples lie at one point, expected a surveyed region")


def _doubt_field(survey: Survey) -> Iterator[str]:
    if words := constant_field(survey):
        yield words
    else:
        yield from doubt_axes(survey)
    magnitude, (low, high) = np.linalg.norm(survey.field, axis=1), MEDIAN_FIELD
    for n, side, bound in (((magnitude < low).sum(), "below", low), ((magnitude > high).sum(), "above", high)):
        if n:
            text = f"{n} of {len(survey)} samples have a field {side} {field_text(bound)}"
            yield f"{text}: rows in two units, or a sensor that fails?"


def _doubt_extent(survey: Survey, read_as: LengthUnit) -> Iterator[str]:
    size = float(extent(survey).max())
    if size < ODD_EXTENT[0]:
        yield f"the positions span only {size:.3g} m: other units, or degrees of latitude and longitude?"
    elif 0 < float(extent(survey)[:2].max()) < ODD_EXTENT[0] and float(np.abs(survey.centroid[:2]).max()) > 1:
        place = ", ".join(told(v, 4, 1.0) for v in survey.centroid[:2])
        yield f"x and y hardly change around {place}: degrees? State them: --columns lat=THEIRS,lon=..."
    elif size > ODD_EXTENT[1]:
        found = f"the positions span {size / 1e3:.3g} km, read as {read_as}"
        yield f"{found}: millimetres or centimetres (--length-unit)?"
    if words := odd_speed(survey):
        yield words


def odd_speed(survey: Survey) -> str:
    """Say that a log moves faster than whoever carries a magnetometer; nothing otherwise."""
    if survey.times is None or (speed := float(np.median(_speeds(survey)))) <= ODD_SPEED:
        return ""
    if float(np.median(np.diff(survey.times))) < FASTEST and speed <= ODD_SPEED * DAY:
        return f"the sensor moves at {speed:.3g} m/s: are its times in days? Multiply them by {DAY:.0f}"
    return f"the sensor moves at {speed:.3g} m/s: wrong length unit (--length-unit), or times not in seconds?"


def jumps(survey: Survey) -> Indices:
    """Samples after which the position jumps: no step of whoever carries the sensor."""
    is_long = _are_long_steps(survey)
    if not is_long.any() or odd_speed(survey):
        return np.zeros(0, np.int64)
    return np.flatnonzero(is_long & (_speeds(survey) > ODD_SPEED))


def _restarts(survey: Survey) -> Indices:
    """Samples after which the position jumps to that of the first one, exactly, and goes on from there."""
    is_long = _are_long_steps(survey)
    is_back = (survey.positions[1:] == survey.positions[0]).all(axis=1)
    return np.flatnonzero(is_long & is_back & ~np.append(is_long[1:], False))


def _are_long_steps(survey: Survey) -> Mask:
    """Whether the step after each sample but the last is far longer than is usual; of no step without times."""
    steps = np.linalg.norm(np.diff(survey.positions, axis=0), axis=1)
    if survey.times is None or not steps.any():
        return np.zeros(len(steps), dtype=np.bool_)
    return np.asarray(steps > JUMP * typical_step(steps))


def _doubt_jumps(survey: Survey) -> Iterator[str]:
    if survey.times is None:
        return
    again = _restarts(survey)
    if len(again):
        said = f"the position jumps to exactly the first one at {told(survey.times[again[0] + 1])} s{_more(again)}"
        yield f"{said}: was odometry restarted there? Give each part as a log of its own"
    rows = np.setdiff1d(jumps(survey), again)
    if len(rows):
        steps = np.linalg.norm(survey.positions[rows + 1] - survey.positions[rows], axis=1)
        k = int(steps.argmax())
        said = f"the position jumps by {steps[k]:.3g} m at {told(survey.times[rows[k]])} s{_more(rows)}"
        yield f"{said}: odometry that lost itself, or two logs in one?"


def _more(found: Indices) -> str:
    return f", and {len(found) - 1} more" if len(found) > 1 else ""


def _speeds(survey: Survey) -> Scalars:
    steps, times = np.linalg.norm(np.diff(survey.positions, axis=0), axis=1), survey.times
    assert times is not None
    with np.errstate(over="ignore"):  # absurd times make it infinite, and odd
        return np.asarray(steps / np.diff(times))


def _doubt_shape(survey: Survey) -> Iterator[str]:
    offset = survey.positions - survey.centroid
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(offset.T @ offset / len(survey))[::-1], 0))
    flat = FLAT * min(1.0, spread[0])
    if spread[1] <= flat:
        yield "all samples lie on one line: the field beside it and rotations about it are poorly determined"
    elif spread[2] <= flat:
        yield "all samples lie on one plane: the field above and below it is inferred, not measured"


def _doubt_repeats(survey: Survey) -> Iterator[str]:
    n = len(survey) - 1
    n_still = int((np.diff(survey.positions, axis=0) == 0).all(axis=1).sum())
    if n_still > 0.05 * n:
        share = f"{100 * n_still / n:.0f} %"
        yield f"{share} of the samples repeat the position before them: at rest, or a pose rate below the field's?"
    # Of a sensor that turns, readings that are held are turned with it.
    readings = sensor_readings(survey)
    is_repeat = find_repeats(survey.field) | find_repeats(readings)
    if words := _stuck_while_moving(survey, is_repeat):
        yield words
    elif 0.05 * n < (n_stuck := int(is_repeat.sum())) < n:
        yield f"{100 * n_stuck / n:.0f} % of the samples repeat the field before them: logged faster than measured?"
    yield from _doubt_turns(survey.positions, readings)


def _stuck_while_moving(survey: Survey, is_repeat: Mask) -> str:
    """Name the longest stretch in which the field stands still and the body moves; nothing if there is none.

    There a reading is held far longer than is usual, and the next one is farther from it than neighbours are: of a
    sensor with coarse digits, it would be the next digit.
    """
    starts = np.flatnonzero(~is_repeat)
    ends = np.append(starts[1:], len(survey))  # one past each run
    walked = path_walked(survey.positions)
    leaps = np.append(np.linalg.norm(survey.field[ends[:-1]] - survey.field[ends[:-1] - 1], axis=1), np.inf)
    lengths, ways = ends - starts, walked[ends - 1] - walked[starts]
    is_stuck = lengths >= LONG * np.quantile(lengths, USUAL_HOLD)
    is_stuck &= (leaps > np.median(leaps)) & (ways > HALF * lengths * np.median(np.diff(walked))) & (ways > 0)
    if not is_stuck.any():
        return ""
    k = int((lengths * is_stuck).argmax())
    rows, times = (int(starts[k]), int(ends[k]) - 1), survey.times
    first, last = (f"sample {row}" if times is None else f"{told(times[row])} s" for row in rows)
    more = f", and in {is_stuck.sum() - 1} more stretches" if is_stuck.sum() > 1 else ""
    said = f"the field reads the same from {first} to {last}, over {ways[k]:.3g} m of the way{more}"
    return f"{said}: did the sensor hang? Leave these samples out, as magmatch prepare does"


def _doubt_turns(positions: Points, readings: Vectors) -> Iterator[str]:
    """Whether readings go to and fro where positions do not: of one sensor, the one after next is no nearer."""
    if len(readings) < FEW:
        return
    next_one, after = _typical_steps(readings)
    step, two_steps = _typical_steps(positions)
    if next_one > TO_AND_FRO * max(after, RESOLVED) and two_steps >= ONWARD * step:
        yield f"the field goes to and fro by {field_text(next_one)} from sample to sample: two sensors in one log?"


def _typical_steps(vectors: Vectors) -> tuple[float, float]:
    """Median distance of neighbours, and of those that one other lies between."""
    one, two = (float(np.median(np.linalg.norm(vectors[k:] - vectors[:-k], axis=1))) for k in (1, 2))
    return one, two


def _doubt_times(survey: Survey, read_as: TimeUnit) -> Iterator[str]:
    if survey.times is None:
        return
    unit = _likely_time_unit(survey.times, survey.positions, read_as)
    if unit not in {None, read_as}:
        step = float(np.median(np.diff(survey.times)))
        span = f"times begin at {told(survey.times[0])} s, with a sample every {step:.4g} s"
        yield f"{span}: are they in {unit}? (--time-unit {unit})"
    elif len(gaps := time_gaps(survey)):
        yield f"time has {many(len(gaps), 'gap')}, {gaps.sum():.3g} s in all, the longest {gaps.max():.3g} s"


def _likely_time_unit(times: Scalars, positions: Points, read_as: TimeUnit) -> TimeUnit | None:
    """The unit that whole numbers of times are probably in; None where those do not look like another than stated."""
    numbers = times * UNITS_PER_SECOND[read_as]
    if not (np.abs(numbers - np.round(numbers)) <= ROUNDING_OF_TIMES * np.abs(numbers)).all():
        return None
    finer: tuple[TimeUnit, ...] = ("ms", "us", "ns")
    interval = float(np.median(np.diff(numbers)))
    for unit in finer:
        per_second = UNITS_PER_SECOND[unit]
        if SINCE_1970[0] < numbers[0] / per_second < SINCE_1970[1] and interval < RAREST * per_second:
            return unit
    step = float(np.median(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    seconds = interval / UNITS_PER_SECOND[read_as]
    if not (seconds > SLOW[0] and step < SLOW[1] * seconds):
        return None
    return next((unit for unit in finer if interval <= SLOW[0] * UNITS_PER_SECOND[unit]), None)
