# SPDX-License-Identifier: BSD-3-Clause
"""A survey along a line: averaged in short bins along its path, and the test for being a line."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform

from magmatch.compiled import compiled_ahead
from magmatch.data.survey import Survey
from magmatch.estimation.candidate_poses import OUTLIER_SHARE
from magmatch.estimation.cubes import even_choice
from magmatch.estimation.limits import COARSER, FEW_POINTS, MAX_WEIGHED
from magmatch.typing import Indices, Matrix, Points, Vectors

# Length of a bin, in the base's correlation length: short against the field's changes, long against noise.
BIN_LENGTH = 0.15
# A survey is a line, or a plane, if it spreads across by less than this share of the extent along.
MAX_BREADTH = 0.2
# Fewest bins that a walk is judged by.
MIN_BINS = 8


@dataclass(frozen=True, eq=False)
class Walk:
    """A line of samples in its own principal frame."""

    T_survey_walk: RigidTransform  # takes the walk's coordinates to the survey's
    positions: Points  # (n, 3), m: mean position of each bin along the path
    field: Vectors  # (n, 3), T: mean field of each bin
    pose_sd: float = 0.0  # m: accuracy of the survey's own positions

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def bin_length(self) -> float:
        """Path per bin, m."""
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        return float(np.median(steps)) if len(steps) else 0.0

    @property
    def length(self) -> float:
        """Path in all bins, m."""
        return self.bin_length * len(self)

    @cached_property
    def distance(self) -> Matrix:
        """Distances between the bins: (n, n), m."""
        return np.asarray(cdist(self.positions, self.positions))

    def part(self, rows: Indices) -> "Walk":
        """A subset of the bins."""
        return replace(self, positions=self.positions[rows], field=self.field[rows])


def walk_of(survey: Survey, length: float) -> Walk:
    """Average a survey, in the order it was taken, in bins along its path; ``length``: the base's scale, m."""
    T_survey_walk = survey.principal_frame()
    local = survey.transformed(T_survey_walk.inv())
    side = BIN_LENGTH * length
    while True:
        rows = bin_along_path(local.positions, side)
        if rows[-1] < MAX_WEIGHED:
            break
        side *= COARSER
    positions, field = (bin_means(values, rows) for values in (local.positions, local.field))
    return Walk(T_survey_walk, positions, field, survey.pose_sd)


def bin_along_path(positions: Points, side: float) -> Indices:
    """Bin of each sample: a new one begins at a sample that is farther than ``side`` from the bin's first."""
    rows = np.zeros(len(positions), dtype=np.int64)
    _bin(np.ascontiguousarray(positions), side, rows)
    return rows


@compiled_ahead("f8[:,::1], f8, i8[::1]")
def _bin(positions, side, rows):  # type: ignore[no-untyped-def]
    first, row = 0, 0
    for n in range(1, len(positions)):
        d2 = 0.0
        for c in range(3):
            step = positions[n, c] - positions[first, c]
            d2 += step * step
        if d2 > side * side:
            first = n
            row += 1
        rows[n] = row


def bin_means(values: np.ndarray, rows: Indices) -> np.ndarray:
    """Average rows of values (n, ...) over consecutive bins: (b, ...)."""
    sums = np.zeros((int(rows[-1]) + 1, *values.shape[1:]))
    np.add.at(sums, rows, values)
    return np.asarray(sums / np.bincount(rows).reshape(-1, *[1] * (values.ndim - 1)))


def line_share(positions: Points, radius: float) -> float:
    """Share of the samples whose neighbours within a radius are collinear."""
    some = positions[even_choice(len(positions), FEW_POINTS)]
    is_line = []
    for near in cKDTree(positions).query_ball_point(some, radius):
        offset = positions[near] - positions[near].mean(axis=0)
        across2 = np.linalg.eigvalsh(offset.T @ offset / len(near))[1]
        is_line.append(across2 < (MAX_BREADTH * radius) ** 2)
    return float(np.mean(is_line))


def is_line(survey: Survey, length: float) -> bool:
    """Whether a survey's samples lie along a line at the scale of a correlation length (m)."""
    return line_share(survey.positions, length) >= 1 - OUTLIER_SHARE


def choose_search(target: Survey, length: float) -> Literal["pairs", "invariants"]:
    """Choose the search for a target: pairs of points if it is a short line, a frame at every point otherwise."""
    # A long line crosses itself and fills areas: that is breadth of another kind.
    return "pairs" if is_short(target, length) and is_line(target, length) else "invariants"


def is_resolved(survey: Survey, length: float) -> bool:
    """Whether a survey's path can be weighed in bins that are no longer than a correlation length (m)."""
    return bool(bin_along_path(survey.positions, length)[-1] < MAX_WEIGHED)


def is_short(survey: Survey, length: float) -> bool:
    """Whether a survey's path can be weighed as it is, at twice the resolution that a correlation length (m) asks."""
    rows = bin_along_path(survey.positions, 2 * BIN_LENGTH * length)
    return bool(rows[-1] < MAX_WEIGHED)
