# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of the spline prior: by tempered evidence on a part of the survey, its noise by other passes."""

import logging
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magmatch.field.folds import has_path_order
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.affordability import affordable_spacing, is_affordable
from magmatch.field.selection.evidence_climb import climb, is_allowed, rounded, settle
from magmatch.field.selection.other_passes import OtherPasses
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.field.subset import choose_part, sample_distance
from magmatch.field.variogram import typical_length
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

FEWEST_SAMPLES = 40
# Where all samples lie at one place, m.
LONELY_LENGTHSCALE = 0.5
# In units of the samples' distance: closer splines are more than samples tell apart, or tell for less than they cost,
# which of few samples is little; and where these lie anywhere the reach follows what they may leave between them, and
# half a cell.
CLOSEST_SPLINES, CLOSEST_OF_FEW, CLOSEST_OF_A_PATH, WIDEST_GAP = 1.05, 0.75, 0.4, 1.3
FEW_SAMPLES = 500
# The search starts here: spacing and lengthscale from the variogram, signal over noise and stiffness that suit most;
# along a path a field so smooth that what it leaves shows which errors neighbours share.
LENGTHSCALE_IN_SPACINGS = 4.0
START, START_OF_A_PATH = (120.0, 3000.0), (12.0, 300.0)
# Samples anywhere in a volume fill it; the lanes of a path leave gaps, which the basis has to bridge.
REACH, REACH_OF_A_PATH = 1.5, 2.0
# In lengthscales: so far beyond samples that lie anywhere a smooth field is told of, however close the splines, and
# farther where all lie near a plane, beyond which everything is; what that is worth against closer splines.
TOLD_BEYOND, TOLD_BEYOND_A_PLANE, WORTH_OF_BEYOND = 0.3, 0.6, 4.0
# The next spacing that is tried.
FINER = 0.75
# Operations of one factorisation of the part that is searched: a constant and a share per sample. Of a path it has to
# hold many lanes that cross: from few, nothing tells what they miss of one another.
PART_OPERATIONS, PART_OF_A_PATH = (6e8, 1.5e5), (2e9, 1e4)
# Of a short path, as many as this, and less than a share of any tells too little: so many may be spent on that.
SHORT_PATH, LEAST_OPERATIONS, SHARE_OF_A_PATH, SHARE_OPERATIONS = 20_000, 3e9, 0.3, 8e9
# Where samples lie anywhere, the share of those operations that a smaller part takes, from which all but the spacing
# and the last of the noise can be told; of a path, stiffness cannot.
FEW = 0.35
FEWEST_OF_A_PART, MOST_SEARCHED, MOST_CUTS = 300, 50_000, 4
# The posterior is made a little wider than it says of itself: its numbers are themselves estimates.
LEAST_INFLATION = 1.3


@dataclass(frozen=True, slots=True)
class Layout:
    """How splines lie over samples.

    Attributes
    ----------
    distance : float, m
        Of the samples, as `sample_distance` says.
    closest : float, m
        Least spacing.
    is_path : bool
        Whether they follow one another.
    """

    distance: float
    closest: float
    is_path: bool

    @classmethod
    def over(cls, points: Points) -> "Layout":
        """As these samples ask for."""
        distance, is_path = sample_distance(points), has_path_order(points)
        anywhere = CLOSEST_OF_FEW if len(points) <= FEW_SAMPLES else CLOSEST_SPLINES
        return cls(distance, (CLOSEST_OF_A_PATH if is_path else anywhere) * distance, is_path)

    def reach(self, spacing: float) -> float:
        """How far beyond samples cells of a spacing have to reach."""
        return REACH_OF_A_PATH if self.is_path else rounded(max(REACH, WIDEST_GAP * self.distance / spacing + 0.5))

    def told(self, points: Points, h: Hyperparameters) -> Hyperparameters:
        """Numbers whose reach covers what their field tells of, as far as the survey can afford it."""
        if self.is_path:
            return h
        # Of samples evenly through a layer, twelve times the variance is the square of its thickness.
        thickness = np.sqrt(12 * max(float(np.linalg.eigvalsh(np.cov(points.T))[0]), 0.0))
        is_thin = thickness < h.lengthscale / 2
        farthest = (TOLD_BEYOND_A_PLANE if is_thin else TOLD_BEYOND) * h.lengthscale / h.spacing + 0.5
        tried = (replace(h, reach=rounded(share * farthest)) for share in (1.0, 0.8, 0.65))
        return next((t for t in tried if t.reach > h.reach and is_affordable(points, t, WORTH_OF_BEYOND)), h)

    def finer(self, points: Points, h: Hyperparameters) -> Hyperparameters | None:
        """The next spacing, where samples tell it apart and the survey can afford it."""
        spacing = rounded(FINER * h.spacing)
        if spacing < self.closest:
            return None
        other = replace(h, spacing=spacing, reach=self.reach(spacing))
        return other if is_allowed(other) and is_affordable(points, other) else None


def choose_spline_hyperparameters(points: Points, field: Vectors) -> Hyperparameters:
    """Numbers under which the survey is most likely; deterministic.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T

    Returns
    -------
    Hyperparameters
    """
    length = typical_length(points, field)
    floor = max(float(np.abs(field).max(initial=0.0)) * 1e-6, 1e-15)
    if len(points) < FEWEST_SAMPLES or length == 0 or np.ptp(field, axis=0).max() <= floor:
        return _without_evidence(points, field, length, floor)
    layout = Layout.over(points)
    start = _start(points, field, length, layout)
    search = _searched(points, field, start, *_effort(len(points), layout))
    if layout.is_path:
        few, passes = search, OtherPasses(search, start.lengthscale)
        search.samples_as_one = max(search.correlated_samples(start), search.crowded_samples(start))
    else:
        few, passes = _searched(points, field, start, FEW * search.operations(start), 0, len(search.points)), None
    found = climb(few, start)
    top = settle(search, found if few is search else found.hyperparameters, partial(layout.finer, points))
    best, noise, inflation = top.hyperparameters, max(top.noise_sd, floor), LEAST_INFLATION
    if passes is not None and passes.tell_something:
        # Along a path the nearest samples share their error: what other passes miss by is the noise that a map for
        # other surveys must reckon with.
        alone, misses = noise, passes.misses(_with_noise(best, noise))
        noise = max(noise, misses.size)
        inflation = misses.inflation(noise) * alone / noise
    chosen = layout.told(points, replace(_with_noise(best, noise), inflation=max(LEAST_INFLATION, inflation)))
    log.info("%.0f samples count as one, %s", search.samples_as_one, chosen)
    return chosen


def _with_noise(h: Hyperparameters, noise_sd: float) -> Hyperparameters:
    """The same map from the same samples, with another statement of their noise."""
    return replace(h, noise_sd=noise_sd, looseness=h.looseness * noise_sd / h.noise_sd)


def _start(points: Points, field: Vectors, length: float, layout: Layout) -> Hyperparameters:
    """Where the search starts: the scale at which the field changes, and the spacing the survey can afford."""
    signal = float(np.sqrt(field.var(axis=0).mean()))
    ratio, stiffness = START_OF_A_PATH if layout.is_path else START
    spacing = max(length / LENGTHSCALE_IN_SPACINGS, layout.closest)
    start = Hyperparameters(length / 1.5, signal, signal / ratio, spacing, stiffness, reach=layout.reach(spacing))
    spacing = rounded(affordable_spacing(points, start))
    lengthscale = rounded(max(start.lengthscale, 2 * spacing))
    return replace(start, spacing=spacing, lengthscale=lengthscale, noise_sd=rounded(start.noise_sd))


def _without_evidence(points: Points, field: Vectors, length: float, floor: float) -> Hyperparameters:
    """Where nothing can be compared: a broad prior about what was seen."""
    length = length or LONELY_LENGTHSCALE
    signal = max(float(np.sqrt(field.var(axis=0).mean())), 10 * floor)
    stiffness = START_OF_A_PATH[1]
    h = Hyperparameters(
        length, signal, signal / 10, length / LENGTHSCALE_IN_SPACINGS, stiffness, reach=REACH_OF_A_PATH
    )
    spacing = affordable_spacing(points, h)
    return replace(h, spacing=spacing, lengthscale=LENGTHSCALE_IN_SPACINGS * spacing)


def _effort(n: int, layout: Layout) -> tuple[float, int]:
    """Operations of one factorisation of the part that is searched, and samples that it should hold all the same."""
    if not layout.is_path:
        return PART_OPERATIONS[0] + PART_OPERATIONS[1] * n, 0
    least = LEAST_OPERATIONS if n <= SHORT_PATH else 0.0
    return max(PART_OF_A_PATH[0] + PART_OF_A_PATH[1] * n, least), int(SHARE_OF_A_PATH * n)


def _searched(
    points: Points, field: Vectors, start: Hyperparameters, budget: float, least: int, most: int = MOST_SEARCHED
) -> EvidenceSearch:
    """Search over a part of the survey, small enough to be fast; more where least samples can be paid for."""
    n = min(len(points), most)
    part = np.ones(len(points), dtype=bool) if n == len(points) else choose_part(points, n, 3)
    for cut in range(MOST_CUTS + 1):
        search = EvidenceSearch(points[part], field[part], np.flatnonzero(part), np.float32)
        needed = search.operations(start)
        is_enough = n <= FEWEST_OF_A_PART or (n <= least and needed <= SHARE_OPERATIONS)
        if needed <= budget or is_enough or cut == MOST_CUTS:
            break
        fewest = max(FEWEST_OF_A_PART, least if n > least else 0)
        n = max(int(n * max((budget / needed) ** 0.7, 0.1) * 0.95), fewest)
        part = choose_part(points, n, 1 if 3 * n > len(points) else 3)
    return search
