# SPDX-License-Identifier: BSD-3-Clause
"""One sample per step of path length, so that standing still does not outweigh walking."""

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.typing import Indices, Points


def resample_by_distance(survey: Survey, step: float, average: Literal["mean", "median"]) -> Survey:
    """Average the samples of each step of the way."""
    number = steps_of(survey.positions, step)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(np.append(first, len(number)))

    def mean(rows: np.ndarray) -> np.ndarray:
        sums = np.add.reduceat(rows, first, axis=0)
        return np.asarray(sums / (counts[:, None] if rows.ndim == 2 else counts))

    field = mean(survey.field)
    if average == "median":
        parts = np.split(survey.field, first[1:])
        field = np.array([np.median(part, axis=0) for part in parts])
    turned = None
    if survey.orientations is not None:
        stretches = np.split(np.arange(len(number)), first[1:])
        turned = Rotation.concatenate([survey.orientations[rows].mean() for rows in stretches])
    return replace(
        survey,
        positions=mean(survey.positions),
        field=field,
        times=None if survey.times is None else mean(survey.times),
        orientations=turned,
    )


def steps_of(positions: Points, step: float) -> Indices:
    """Number of the step of the way in which each sample was taken: (n,) int, not decreasing.

    Distance is counted from where the current step began, as the crow flies: the jitter of poses while standing
    still does not add up to a walk.
    """
    number = np.zeros(len(positions), dtype=np.int64)
    origin, current = positions[0], 0
    for i, p in enumerate(positions):
        if (p - origin) @ (p - origin) >= step * step:
            origin, current = p, current + 1
        number[i] = current
    return number
