# SPDX-License-Identifier: BSD-3-Clause
"""Folds for cross-validation of a survey.

Parts are stretches of a path, or cubes if samples are not ordered; two of five groups of parts are held out, one
group at a time. Without an order, a slice off one end is held out too: beyond a survey a model extrapolates, where it
first becomes overconfident.
"""

from dataclasses import dataclass

import numpy as np

from magmatch.geometry import typical_step
from magmatch.typing import Indices, Mask, Points

# Size of a stretch: in lengthscales, at most this share of the extent.
STRETCH_IN_LENGTHSCALES, STRETCH_IN_EXTENTS = 4.0, 0.25
N_GROUPS, FOLDS = 5, (1, 3)
# So large a share of what is left out has to lie within so many standard deviations.
COVERAGE, IN_SDS = 0.95, 1.96
# Fewer samples are not divided.
FEWEST_SAMPLES = 40
# Size of cubes and of the slice, in lengthscales; the slice holds at most this share of the samples.
_CUBE, _SLICE, _SLICE_SHARE = 0.5, 0.5, 0.15


@dataclass(frozen=True, eq=False, slots=True)
class Folds:
    """A survey's samples in parts, and the sets that are held out."""

    part: Indices  # (n,): which part each sample is in
    left_out: tuple[Mask, ...]  # each (n,): one set at a time
    is_path: bool  # whether the parts are stretches of a path

    @property
    def rest(self) -> tuple[Mask, ...]:
        """Sets of parts that are never left out but, perhaps, in the slice."""
        return tuple(folds_of(self.part, others=True)) if self.left_out else ()


def divide(points: Points, lengthscale: float) -> Folds:
    """Stretches of a path, or cubes and a slice off one end."""
    extent, is_path = np.ptp(points, axis=0), has_path_order(points)
    if len(points) < FEWEST_SAMPLES or not extent.max() > 0:
        return Folds(np.zeros(len(points), dtype=np.int64), (), is_path)
    if is_path:
        stretch = path_stretches(points, lengthscale)
        return Folds(stretch, tuple(folds_of(stretch)), is_path)
    cube = cube_numbers(points, max(_CUBE * lengthscale, float(extent.max()) / 200))
    part = np.random.default_rng(0).permutation(int(cube.max()) + 1)[cube]
    along = points[:, int(np.argmax(extent))]
    end = along > max(float(along.max()) - _SLICE * lengthscale, float(np.quantile(along, 1 - _SLICE_SHARE)))
    return Folds(part, (*folds_of(part), *([end] if end.any() and not end.all() else [])), is_path)


def has_path_order(points: Points) -> bool:
    """Whether consecutive samples are neighbours in space, so that they share errors.

    `data.survey.has_order` asks less (times will do, or rows that follow one another however coarsely), and
    `registration` asks for more: that the whole survey is a thin line.
    """
    if len(points) < 3:
        return False
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    places = points[np.append(True, steps > 0)]
    spread = np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1))
    return bool(typical_step(steps) < 0.15 * spread)


def path_segments(points: Points, length: float) -> Indices:
    """Number the stretches of a path of a length (m), shortened where the path would not give ten."""
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    # Jumps between merged surveys are no path.
    along = np.cumsum(np.minimum(step, 10 * typical_step(step) + length / 10))
    n_segments = max(10, int(along[-1] / max(length, 1e-12)))
    segment = (along / max(along[-1], 1e-300) * n_segments).astype(np.int64)
    return np.asarray(np.minimum(segment, n_segments - 1))


def path_stretches(points: Points, lengthscale: float) -> Indices:
    """Number the stretches of a path: long against the lengthscale, short against the region."""
    extent = float(np.ptp(points, axis=0).max())
    return path_segments(points, min(STRETCH_IN_LENGTHSCALES * lengthscale, STRETCH_IN_EXTENTS * extent))


def folds_of(part: Indices, others: bool = False) -> list[Mask]:
    """Sets to leave out: two of five groups of parts (or the three others), as far as they leave something in."""
    groups = [k for k in range(N_GROUPS) if (k in FOLDS) != others]
    return [fold for fold in (part % N_GROUPS == k for k in groups) if fold.any() and not fold.all()]


def cube_numbers(points: Points, size: float) -> Indices:
    """Number the cubes of a size that hold points."""
    cube = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    return np.asarray(np.unique(cube, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)
