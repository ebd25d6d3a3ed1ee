# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of the spline prior: by tempered evidence on a part of the survey, and cross-validated noise.

Along a path stretches are held out and predicted from the rest. Only other passes and the prior can predict one, so
these errors include what a map must expect of other surveys: drifting poses, and structure between the lanes.
"""

import logging
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.folds import COVERAGE, FEWEST_SAMPLES, IN_SDS, folds_of, path_stretches
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.evidence_climb import climb, rounded, settle
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.field.selection.spline_layout import REACH_OF_A_PATH, SplineLayout, affordable_spacing
from magmatch.field.subset import choose_part
from magmatch.field.variogram import typical_length
from magmatch.threads import side_by_side
from magmatch.typing import Mask, Points, Vectors

log = logging.getLogger(__name__)

# Operations of one factorisation of the part that is searched: a constant and a share per sample. Of a path it has to
# hold many lanes that cross: from few, nothing tells what they miss of one another.
PART_OPERATIONS, PART_OF_A_PATH = (6e8, 1.5e5), (2e9, 1e4)
# Of a short path, as many as this, and less than a share of any tells too little: so many may be spent on that.
SHORT_PATH, LEAST_OPERATIONS, SHARE_OF_A_PATH, SHARE_OPERATIONS = 20_000, 3e9, 0.3, 8e9
# Where samples lie anywhere, the share of those operations that a smaller part takes.
SMALLER_PART = 0.35
FEWEST_OF_A_PART, MOST_SEARCHED, MOST_CUTS = 300, 50_000, 4
# Where all samples lie at one place, m.
LONELY_LENGTHSCALE = 0.5
# The search starts with spacing and lengthscale from the variogram, and a ratio of signal to noise and a divergence
# weight that suit most; along a path with a field so smooth that its residuals show which errors neighbours share.
LENGTHSCALE_IN_SPACINGS = 4.0
START, START_OF_A_PATH = (120.0, 3000.0), (12.0, 300.0)
# Least inflation of the posterior: its hyperparameters are themselves estimates.
LEAST_INFLATION = 1.3
# The half of what is left out that is nearest to other passes counts; the rest crosses none and tells nothing. The
# mean of the roots of their errors is taken, so that the few that nothing could predict do not dominate.
SHARE, POWER = 0.5, 0.5
# Distances that differ by less than this share are equal, as those of regular lanes are: rounding chooses none.
EQUALLY_FAR = 1e-6
INFLATIONS = np.geomspace(1.3, 8.0, 13)


def choose_spline_hyperparameters(points: Points, field: Vectors) -> Hyperparameters:
    """Maximum-likelihood hyperparameters of a survey; deterministic."""
    length = typical_length(points, field)
    floor = max(float(np.abs(field).max(initial=0.0)) * 1e-6, 1e-15)
    if len(points) < FEWEST_SAMPLES or length == 0 or np.ptp(field, axis=0).max() <= floor:
        return _without_evidence(points, field, length, floor)
    layout = SplineLayout.over(points)
    start = _start(points, field, length, layout)
    search = search_part(points, field, start, layout.is_path)
    if layout.is_path:
        # The divergence weight of a path cannot be told from fewer samples.
        search.temper(start)
        found = climb(search, start)
        top = settle(search, found, partial(layout.finer, points))
    else:
        found = climb(search_smaller_part(points, field, start, search), start)
        top = settle(search, found.hyperparameters, partial(layout.finer, points))
    best, noise = top.hyperparameters, max(top.noise_sd, floor)
    chosen = best.with_noise(noise)
    missed = cross_validate_path(search, chosen, start.lengthscale) if layout.is_path else None
    if missed is not None:
        chosen = expecting(best, noise, missed)
    chosen = replace(chosen, inflation=max(LEAST_INFLATION, chosen.inflation))
    log.info("integrated autocorrelation time %.0f samples, %s", search.autocorrelation_time, chosen)
    return layout.extrapolating(points, chosen)


def _without_evidence(points: Points, field: Vectors, length: float, floor: float) -> Hyperparameters:
    """Give a broad prior about the measured field, if the evidence cannot be computed."""
    length = length or LONELY_LENGTHSCALE
    signal = max(float(np.sqrt(field.var(axis=0).mean())), 10 * floor)
    spacing = length / LENGTHSCALE_IN_SPACINGS
    h = Hyperparameters(length, signal, signal / 10, spacing, START_OF_A_PATH[1], reach=REACH_OF_A_PATH)
    spacing = affordable_spacing(points, h)
    return replace(h, spacing=spacing, lengthscale=LENGTHSCALE_IN_SPACINGS * spacing)


def _start(points: Points, field: Vectors, length: float, layout: SplineLayout) -> Hyperparameters:
    """Give the start of the search: the scale at which the field changes, and the spacing the survey can afford."""
    signal = float(np.sqrt(field.var(axis=0).mean()))
    ratio, divergence_weight = START_OF_A_PATH if layout.is_path else START
    spacing = max(length / LENGTHSCALE_IN_SPACINGS, layout.closest)
    reach = layout.reach(spacing)
    start = Hyperparameters(length / 1.5, signal, signal / ratio, spacing, divergence_weight, reach=reach)
    spacing = rounded(affordable_spacing(points, start))
    lengthscale = rounded(max(start.lengthscale, 2 * spacing))
    return replace(start, spacing=spacing, lengthscale=lengthscale, noise_sd=rounded(start.noise_sd))


def search_part(points: Points, field: Vectors, start: Hyperparameters, is_path: bool) -> EvidenceSearch:
    """Search over a part of the survey."""
    n = len(points)
    if not is_path:
        return _search(points, field, start, PART_OPERATIONS[0] + PART_OPERATIONS[1] * n, 0, MOST_SEARCHED)
    budget = max(PART_OF_A_PATH[0] + PART_OF_A_PATH[1] * n, LEAST_OPERATIONS if n <= SHORT_PATH else 0.0)
    return _search(points, field, start, budget, int(SHARE_OF_A_PATH * n), MOST_SEARCHED)


def _search(
    points: Points, field: Vectors, start: Hyperparameters, budget: float, least: int, most: int
) -> EvidenceSearch:
    """Search over a part that costs a budget; a larger one where ``least`` samples can be paid for."""
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


def search_smaller_part(
    points: Points, field: Vectors, start: Hyperparameters, search: EvidenceSearch
) -> EvidenceSearch:
    """Search that tells all but the spacing and the last of the noise, of samples that lie anywhere."""
    return _search(points, field, start, SMALLER_PART * search.operations(start), 0, len(search.points))


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutErrors:
    """Errors (T) of predictions of held-out stretches, their variances (T^2), and where other passes are near."""

    errors: Vectors
    variances: Vectors
    is_near: Mask

    @property
    def size(self) -> float:
        """Size of one component's error where other passes are near, T."""
        size = np.linalg.norm(self.errors[self.is_near], axis=1)
        return float((size**POWER).mean() ** (1 / POWER) / np.sqrt(3))

    def inflation(self, noise_sd: float) -> float:
        """Factor on the posterior's standard deviation for which 95 % intervals cover 95 % of the held-out data."""
        size, v = np.abs(self.errors), self.variances
        covered = [(size <= IN_SDS * np.sqrt(noise_sd**2 + f**2 * v)).mean() >= COVERAGE for f in INFLATIONS]
        return float(INFLATIONS[np.argmax(covered) if any(covered) else -1])


def cross_validate_path(search: EvidenceSearch, h: Hyperparameters, lengthscale: float) -> HeldOutErrors | None:
    """Hold out stretches of a path, long relative to a lengthscale; None if none can be held out."""
    points, left_out = search.points, folds_of(path_stretches(search.points, lengthscale))
    if not left_out:
        return None

    def predict(fold: Mask) -> tuple[Vectors, Vectors]:
        posterior, x = search.fit_without(fold, h), points[fold]
        error = posterior.evaluate(x).field - search.field[fold]
        return error, np.diagonal(posterior.covariance(x), axis1=1, axis2=2)

    errors, variances = zip(*side_by_side(predict, left_out), strict=True)
    distance = np.concatenate([cKDTree(points[~fold]).query(points[fold])[0] for fold in left_out])
    is_near = distance <= np.quantile(distance, SHARE) * (1 + EQUALLY_FAR)
    return HeldOutErrors(np.concatenate(errors), np.concatenate(variances), is_near)


def expecting(h: Hyperparameters, evident_noise_sd: float, missed: HeldOutErrors) -> Hyperparameters:
    """Noise and spread that a map must expect of other surveys; the mean is unchanged.

    Along a path the nearest samples share their error: the errors of other passes exceed the noise found by the
    evidence. ``missed``: the errors of a posterior with that noise and without inflation.
    """
    noise = max(evident_noise_sd, missed.size)
    return replace(h.with_noise(noise), inflation=missed.inflation(noise) * evident_noise_sd / noise)
