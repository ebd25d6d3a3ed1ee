# SPDX-License-Identifier: BSD-3-Clause
"""Readings that say nothing: of axes stuck at one value or at the end of their range, and marks of missing ones.

All are values that come back exactly, so they are looked for in the sensor's own axes: in those of the survey no
value comes back once the sensor turns. Readings that were turned there and back differ by rounding; `Levels` counts
those as one value.
"""

import logging
from dataclasses import dataclass

import numpy as np

from magmatch.data.survey import Survey
from magmatch.data.units import TESLA_PER_UNIT, field_text
from magmatch.errors import in_short
from magmatch.number_text import told
from magmatch.typing import Indices, Mask, Scalars, Vectors

log = logging.getLogger(__name__)

# T: fields that differ by less are equal; of any magnetometer it is rounding.
RESOLVED = TESLA_PER_UNIT["nT"]
# Samples, or steps: of fewer, nothing is told.
FEW = 10
# Share of the field's size up to which values are one: a turn there and back in float64 leaves 1e-15 of it, one that
# was written with nine digits in between 1e-9. The last digit of any magnetometer is above 1e-6.
ROUNDING = 1e-9
# Readings at one and the same largest value before it is the sensor's range, and how many values an axis must take at
# least: of one that hardly changes, measured in coarse digits, the largest value may well be the commonest.
FEWEST_AT_LIMIT, FEWEST_LEVELS = 5, 8
# An axis is stuck where more than half of its readings are one value, and the values beside that have no more than a
# quarter of these together: of a quiet axis in coarse digits they have more.
HALF, BESIDE = 0.5, 0.25
# An axis that shows less than this share of what turns make of the mean field has no gain worth the name.
LEAST_GAIN = 0.1
# An axis is stuck for a while where it reads one value in so many new readings on end, though turns alone would
# change it by half of the field.
LONG = 20
ALIKE = "read the same"
# Share of readings at a limit that is worth a warning: fewer cut off no more than noise does.
WORTH_SAYING = 0.01
# Programs write 0, 0, 0 or a number out of range where a magnetometer gave no reading: a value that comes back
# exactly, and is so many times the median field. Coarse or held readings beside a magnet come back too, but at many
# values; a mark is one, or one at each end of a range.
OUT_OF_RANGE, FEWEST, MOST_MARKS = 10.0, 2, 2


@dataclass(frozen=True, eq=False, slots=True)
class Levels:
    """The distinct values of an axis, up to rounding."""

    values: Scalars  # (k,), T: ascending
    counts: Indices  # (k,): new readings at each; what is held says nothing more
    number: Indices  # (n,): the value at which each reading is

    @classmethod
    def of(cls, readings: Vectors) -> "list[Levels]":
        """Distinct values of each axis."""
        is_new, size, found = ~find_repeats(readings), float(np.median(np.linalg.norm(readings, axis=1))), []
        for values in readings.T:
            order = np.argsort(values, kind="stable")
            is_other = np.diff(values[order], prepend=-np.inf) > ROUNDING * size
            number = np.empty(len(values), dtype=np.int64)
            number[order] = np.cumsum(is_other) - 1
            found.append(cls(values[order][is_other], np.bincount(number[is_new], minlength=is_other.sum()), number))
        return found


def sensor_readings(survey: Survey) -> Vectors:
    """Give what the sensor read in its own axes, up to rounding: (n, 3), T; the field itself without orientations."""
    return survey.field if survey.orientations is None else survey.orientations.apply(survey.field, inverse=True)


def is_constant(field: Vectors) -> bool:
    """Whether a field (n, 3), T, varies nowhere: nothing tells places apart."""
    return float(field.std(axis=0).max()) < RESOLVED


def find_repeats(readings: Vectors) -> Mask:
    """Readings equal to the one before, up to the rounding of a turn to and fro."""
    is_same = np.zeros(len(readings), dtype=bool)
    size = np.linalg.norm(readings[1:], axis=1)
    is_same[1:] = np.linalg.norm(np.diff(readings, axis=0), axis=1) <= ROUNDING * size
    return is_same


def without_missing(survey: Survey) -> Survey:
    """Leave out samples whose reading is a mark, with a warning."""
    is_mark = missing(survey)
    return survey.subset(~is_mark) if is_mark.any() else survey


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers become infinite; they are refused later
def missing(survey: Survey) -> Mask:
    """Samples whose reading is a mark, (n,), with a warning; none where all are: the columns are wrong then.

    Marks are in the sensor's axes, or in those of the survey where a program turned the readings.
    """
    sizes = np.linalg.norm(survey.field, axis=1)
    is_mark: Mask = np.asarray(sizes == 0)
    if is_mark.all():
        return np.zeros(len(survey), dtype=bool)
    marks = ["0, 0, 0"] if is_mark.any() else []
    most = OUT_OF_RANGE * float(np.median(sizes[~is_mark]))
    if sizes.max() > most:  # in most surveys none is: no axis reads more than the field's size
        turned = () if survey.orientations is None else Levels.of(sensor_readings(survey))
        for levels in (*turned, *Levels.of(survey.field)):
            # What is held counts, too.
            odd = np.flatnonzero((np.abs(levels.values) > most) & (np.bincount(levels.number) >= FEWEST))
            if len(odd) <= MOST_MARKS:
                is_mark |= np.isin(levels.number, odd)
                marks += [field_text(value) for value in levels.values[odd].tolist()]
    if is_mark.all():
        return np.zeros(len(survey), dtype=bool)
    if is_mark.any():
        said = " or ".join(in_short([*dict.fromkeys(marks)]))
        words = "%s: left out %d of %d samples that read %s: marks of a missing reading, or one out of range"
        log.warning(words, survey.name, is_mark.sum(), len(survey), said)
    return is_mark


def at_limit(readings: Vectors) -> Mask:
    """Find the components that are at the end of the sensor's range: (n, 3).

    More are at one largest value than at the next three: noise thins out toward the end, a limit piles values up.
    """
    is_limited = np.zeros(readings.shape, dtype=bool)
    sizes = np.linalg.norm(readings, axis=1)
    # Zero in all axes is a drop-out.
    rows = np.flatnonzero(sizes > ROUNDING * np.median(sizes))
    for axis, levels in enumerate(Levels.of(readings[rows])):
        if len(levels.counts) < FEWEST_LEVELS:
            continue
        for end, next_ones in ((0, slice(1, 4)), (len(levels.counts) - 1, slice(-4, -1))):
            if levels.counts[end] >= FEWEST_AT_LIMIT and levels.counts[end] > levels.counts[next_ones].sum():
                is_limited[rows, axis] |= levels.number == end
    return is_limited


def stuck_axes(survey: Survey) -> list[str]:
    """Name the axes that read one value in most samples, or hardly follow the sensor's turns."""
    names, readings = _names(survey), sensor_readings(survey)
    stuck = {k: f"reads {field_text(v)} in {_share(mask)}" for k, (v, mask) in find_stuck(readings).items()}
    if survey.orientations is None:
        size = float(np.median(np.linalg.norm(readings, axis=1)))
        dead = {way: "" for way, b in _ways(readings).items() if float(np.ptp(b)) <= ROUNDING * size}
    else:
        # The median: rows in another unit are no field that turns would show.
        turned = survey.orientations.apply(np.median(survey.field, axis=0), inverse=True)
        dead = _dead_ways(readings, turned)
        stuck = {way[0]: words for way, words in dead.items() if len(way) == 1} | stuck
        stuck = _stuck_for_a_while(readings, turned, survey.times) | stuck
    pairs = [way for way in dead if len(way) == 3 and not stuck.keys() & {way[0], way[1]}]
    alike = [f"{names[i]} and {names[k]} {ALIKE}{', reversed' * (s > 0)}" for i, k, s in pairs]
    return [f"{names[k]} {words}" for k, words in sorted(stuck.items())] + alike


def _ways(vectors: Vectors) -> dict[tuple[int, ...], Scalars]:
    """Each axis, and differences and sums of two: constant where these read the same, or the same reversed."""
    ways: dict[tuple[int, ...], Scalars] = {(k,): vectors[:, k] for k in range(3)}
    return ways | {(i, k, s): vectors[:, i] + s * vectors[:, k] for i, k in ((0, 1), (0, 2), (1, 2)) for s in (-1, 1)}


def _dead_ways(readings: Vectors, turned: Vectors) -> dict[tuple[int, ...], str]:
    """Say how readings hardly follow what turns make of the mean field; see `_ways`."""
    dead = {}
    for (way, read), expected in zip(_ways(readings).items(), _ways(turned).values(), strict=True):
        varies, most = (float(np.ptp(np.quantile(b, [0.1, 0.9]))) for b in (read, expected))
        if varies < LEAST_GAIN * most:
            sizes = f"varies by {field_text(varies)}, expected {field_text(most)}"
            dead[way] = f"hardly follows the sensor's turns ({sizes})"
    # Of all three, it is the orientations that are wrong.
    return {} if {(0,), (1,), (2,)} <= dead.keys() else dead


def _stuck_for_a_while(readings: Vectors, turned: Vectors, times: Scalars | None) -> dict[int, str]:
    """Name the axes that read one value on end though the sensor turned; not at the end of their range."""
    is_new, is_limited = ~find_repeats(readings), at_limit(readings)
    size, found = float(np.median(np.linalg.norm(turned, axis=1))), {}
    for axis, levels in enumerate(Levels.of(readings)):
        rows = np.flatnonzero(is_new & ~is_limited[:, axis])
        starts = np.flatnonzero(np.diff(levels.number[rows], prepend=-1))
        lengths = np.diff(starts, append=len(rows))
        for k in np.flatnonzero(lengths >= LONG):
            run = rows[starts[k] : starts[k] + lengths[k]]
            if float(np.ptp(turned[run, axis])) > HALF * size:
                ends = [told(times[k]) if times is not None else f"sample {k}" for k in run[[0, -1]].tolist()]
                unit = " s" if times is not None else ""
                value = field_text(float(readings[run[0], axis]))
                found[axis] = f"reads {value} from {ends[0]} to {ends[1]}{unit}, though it turned"
                break
    return found


def find_stuck(readings: Vectors) -> dict[int, tuple[float, Mask]]:
    """Find axes that are stuck: the value (T) of each, and which readings (n, 3) are at it."""
    found = {}
    for axis, levels in enumerate(Levels.of(readings)):
        most = int(levels.counts.argmax())
        count = levels.counts[most]
        beside = levels.counts[max(most - 1, 0) : most + 2].sum() - count
        if count > HALF * levels.counts.sum() and beside <= BESIDE * count:
            found[axis] = float(levels.values[most]) + 0.0, levels.number == most
    return found


def doubt_axes(survey: Survey) -> list[str]:
    """Name the axes that are stuck, else those that reach the end of their range."""
    if stuck := stuck_axes(survey):
        why = {True: "one axis is written twice", False: "it is stuck or at the end of its range"}
        return [f"{words}: {why[ALIKE in words]}, nothing is estimated from it" for words in stuck]
    readings, found = sensor_readings(survey), []
    for name, values, is_limited in zip(_names(survey), readings.T, at_limit(readings).T, strict=True):
        if is_limited.mean() >= WORTH_SAYING:
            digit = ROUNDING * float(np.median(np.linalg.norm(readings, axis=1)))
            limits = np.unique(np.round(values[is_limited] / digit)) * digit
            ends = " and ".join(dict.fromkeys(field_text(float(v)) for v in limits + 0.0))
            found.append(f"{name} is at the end of its range, {ends}, in {_share(is_limited)}: the field is stronger")
    return found


def _names(survey: Survey) -> list[str]:
    """Name some axes."""
    words = "the field's {} component" if survey.orientations is None else "the sensor's {} axis"
    return [words.format(axis) for axis in "xyz"]


def _share(mask: Mask) -> str:
    return f"all {len(mask)} samples" if mask.all() else f"{100 * mask.mean():.0f} % of the samples"
