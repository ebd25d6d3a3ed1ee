# SPDX-License-Identifier: BSD-3-Clause
"""Readings that are marks: programs write 0, 0, 0 or a number out of range where a magnetometer gave no reading."""

import logging

import numpy as np

from magmatch.data.sensor_axes import Levels, sensor_readings
from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.errors import in_short
from magmatch.typing import Mask

log = logging.getLogger(__name__)

# A value that comes back exactly, and is so many times the median field. Coarse or held readings beside a magnet come
# back too, but at many values; a mark is one, or one at each end of a range.
OUT_OF_RANGE, FEWEST, MOST_MARKS = 10.0, 2, 2


def without_missing(survey: Survey) -> Survey:
    """Leave out samples whose reading is a mark, with a warning."""
    is_mark = missing(survey)
    return survey.subset(~is_mark) if is_mark.any() else survey


def missing(survey: Survey) -> Mask:
    """Samples whose reading is a mark, (n,), with a warning; none where all are: the columns are wrong then."""
    is_mark, values = find_marks(survey)
    if is_mark.all():
        return np.zeros(len(survey), dtype=bool)
    if is_mark.any():
        told = " or ".join(in_short([*dict.fromkeys(field_text(value) if value else "0, 0, 0" for value in values)]))
        words = "%s: left out %d of %d samples that read %s: marks of a missing reading, or one out of range"
        log.warning(words, survey.name, is_mark.sum(), len(survey), told)
    return is_mark


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers become infinite; they are refused later
def find_marks(survey: Survey) -> tuple[Mask, list[float]]:
    """Samples whose reading is a mark (n,), and the values, T, that mark them: 0 is said of all axes together.

    Marks are in the sensor's axes, or in those of the survey where a program turned the readings.
    """
    sizes = np.linalg.norm(survey.field, axis=1)
    is_mark = sizes == 0
    values = [0.0] if is_mark.any() else []
    if is_mark.all():
        return is_mark, values
    most = OUT_OF_RANGE * float(np.median(sizes[~is_mark]))
    if sizes.max() <= most:
        return is_mark, values  # as in most surveys: no axis reads more than the field's size
    turned = () if survey.orientations is None else Levels.of(sensor_readings(survey))
    for levels in (*turned, *Levels.of(survey.field)):
        # What is held counts, too.
        odd = np.flatnonzero((np.abs(levels.values) > most) & (np.bincount(levels.number) >= FEWEST))
        if len(odd) <= MOST_MARKS:
            is_mark |= np.isin(levels.number, odd)
            values += levels.values[odd].tolist()
    return is_mark, values
