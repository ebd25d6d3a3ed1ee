# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of the spline prior by leaving out whole stretches of the survey.

Evidence would be cheaper, but along a path errors are correlated (poses drift, steel moves the field at small
scale), and evidence then follows them. What is left out here is a whole stretch, so only other passes and the prior
can predict it.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.cells import MAX_BOX_CELLS, CellGrid, lay_cells
from magmatch.field.held_out import choose_part, has_path_order, path_segments, space_blocks, typical_length
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.nested_dissection import Elimination, order_elimination
from magmatch.field.region_model import fit_operations
from magmatch.field.spline_model import REACH_IN_CELLS, SplineInformation, SplineModel, SplinePosterior
from magmatch.typing import Mask, Points, Vectors

log = logging.getLogger(__name__)

FEWEST_SAMPLES = 40
# Where all samples lie at one place, m.
LONELY_LENGTHSCALE = 0.5
# The search starts here: spacing and lengthscale from the variogram, signal to noise and stiffness fixed.
LENGTHSCALE_IN_SPACINGS = 3.5
SIGNAL_TO_NOISE, STIFFNESS = 100.0, 3000.0
# Two fifths are held out, one fifth at a time.
N_GROUPS, FOLDS = 5, (1, 3)
# Moves tried in turn: what is multiplied, by which factor, and by which share it must predict better to be taken.
# Held-out errors are themselves uncertain and the start is a good one, so those that would cost most if they were
# wrong (a stiffer, coarser or rougher model) need the best reasons.
MOVES = (
    ("signal_sd", 3.0, 0.03),
    ("spacing", 0.75, 0.02),
    ("spacing", 1 / 0.75, 0.05),
    ("lengthscale", 1.6, 0.04),
    ("lengthscale", 1 / 1.6, 0.04),
    ("stiffness", 0.1, 0.04),
)
# Of the absolute value of a standard normal variable.
MEDIAN_OF_NORMAL = 0.6745
ROUNDS, MOST_STEPS = 2, 3
# Bounds of the ratio of lengthscale and spacing, and of the stiffness.
RELATIVE_LENGTHSCALES, STIFFNESSES = (1.5, 12.0), (3.0, 3001.0)
# The posterior is made a little wider than it says of itself even where held-out samples agree with it: its numbers
# are themselves estimates, and the rim of a survey is less certain than what can be held out.
INFLATIONS = np.geomspace(1.3, 8.0, 13)
# Stretches left out of a path: long against the lengthscale, short against the region.
SEGMENT_IN_LENGTHSCALES, SEGMENT_IN_EXTENTS = 4.0, 0.25
# Residuals below this share of the field's spread count as this large.
SMALLEST_ERROR = 0.02
# Operations of one factorisation: of the part that is searched at the first spacing, and of the whole survey at the
# finest; each a constant and a share per sample. A spacing that would cost the whole more than the last is widened.
PART_OPERATIONS, FINE_OPERATIONS, MOST_OPERATIONS = (1e9, 5e4), (2e10, 1e6), (1e11, 1.5e6)
# Samples beyond these do not widen the search.
MOST_SEARCHED = 50_000
COARSER = 1.25


@dataclass(frozen=True, slots=True)
class Score:
    """How held-out residuals are summed up.

    Attributes
    ----------
    power : float
        Of their mean. Stretches that nothing else comes near miss by as much as the field varies, whatever the
        numbers; a low power keeps them from drowning those that can be predicted.
    share : float
        Share of the held-out samples, those nearest to others, that count.
    """

    power: float
    share: float


# Blocks lie among others and count in full; of stretches, many cross no other pass and tell nothing.
BLOCK_SCORE, PATH_SCORE = Score(2.0, 1.0), Score(0.5, 0.5)


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """One point of the search: its numbers and the error of held-out predictions."""

    hyperparameters: Hyperparameters
    error: float


class HeldOutSearch:
    """Errors of held-out samples under trial hyperparameters, with the parts that trials share kept.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T
    folds : list of (n,) bool arrays
        What is held out, one set at a time.
    score : Score
        How residuals are summed up.
    whole : (m, 3) array, m
        All points of the survey of which these are a part; trials that it could not afford are refused.
    """

    def __init__(self, points: Points, field: Vectors, folds: list[Mask], score: Score, whole: Points) -> None:
        self.points, self.field, self.folds, self.score, self.whole = points, field, folds, score, whole
        self._affordable: dict[float, bool] = {}
        away = [cKDTree(points[~fold]).query(points[fold])[0] for fold in folds]
        distance = np.concatenate([*away, np.zeros(0)])
        self._is_scored = distance <= np.quantile(np.append(distance, 0.0), score.share)
        self._smallest = SMALLEST_ERROR**2 * float(field.var(axis=0).sum())
        self._grids: dict[float, tuple[CellGrid, Elimination, list[SplineInformation]]] = {}
        self._errors: dict[Hyperparameters, float] = {}

    def operations(self, spacing: float) -> float:
        """Cost of one factorisation at a spacing."""
        return self._grid(spacing)[1].n_operations

    def is_affordable(self, spacing: float) -> bool:
        """Whether the whole survey can be fitted at a spacing in reasonable time."""
        if spacing not in self._affordable:
            limit = _budget(FINE_OPERATIONS, len(self.whole))
            self._affordable[spacing] = _operations(self.whole, spacing) <= limit
        return self._affordable[spacing]

    def error(self, h: Hyperparameters) -> float:
        """Power mean of the held-out residuals' lengths; infinite where the numbers cannot be used."""
        if h not in self._errors:
            try:
                residuals = np.concatenate([self._residuals(*fold) for fold in self._fits(h)])
                square = (residuals[self._is_scored] ** 2).sum(axis=1) + self._smallest
                self._errors[h] = float((square ** (self.score.power / 2)).mean() ** (1 / self.score.power))
            except np.linalg.LinAlgError:
                self._errors[h] = np.inf
        return self._errors[h]

    def calibration(self, h: Hyperparameters) -> tuple[float, float]:
        """Noise level and inflation of the posterior: the sharpest that cover 95 % of the held-out components.

        With v the posterior variance of a trial in units of its noise variance, held-out residuals are taken to have
        variance ``s^2 (1 + r v)``. For each r, s is set by coverage; the r of the smallest mean
        log width wins, among those with s no smaller than the residuals of samples that were fitted. The inflation
        is relative to the noise s: ``sqrt(r)``.
        """
        residuals, variance, fitted = [], [], []
        for posterior, fold in self._fits(h):
            residuals.append(np.abs(self._residuals(posterior, fold)))
            fitted.append(np.abs(self._residuals(posterior, ~fold)).ravel())
            covariance = posterior.covariance(self.points[fold]) / h.noise_sd**2
            variance.append(np.diagonal(covariance, axis1=1, axis2=2))
        size, v = np.concatenate(residuals), np.concatenate(variance)
        smallest = float(np.median(np.concatenate(fitted))) / MEDIAN_OF_NORMAL
        best = (np.inf, smallest, 1.0)
        for ratio in INFLATIONS**2:
            width = np.sqrt(1.0 + ratio * v)
            noise = float(np.quantile(size / width, 0.95) / 1.96)
            noise = max(noise, smallest, 1e-300)
            best = min(best, (float(np.log(noise) + np.log(width).mean()), noise, float(np.sqrt(ratio))))
        return best[1], best[2]

    def _fits(self, h: Hyperparameters) -> Iterator[tuple[SplinePosterior, Mask]]:
        """Fit to the samples outside of each fold."""
        cells, elimination, informations = self._grid(h.spacing)
        model = SplineModel(h, cells, elimination)
        for information, fold in zip(informations, self.folds, strict=True):
            yield model.infer(information), fold

    def _residuals(self, posterior: SplinePosterior, fold: Mask) -> Vectors:
        residuals: Vectors = posterior.evaluate(self.points[fold]).field - self.field[fold]
        return residuals

    def _grid(self, spacing: float) -> tuple[CellGrid, Elimination, list[SplineInformation]]:
        if spacing not in self._grids:
            cells = lay_cells(self.points, spacing, REACH_IN_CELLS)
            elimination = order_elimination(cells)
            model = SplineModel(Hyperparameters(1.0, 1.0, 1.0, spacing), cells, elimination)
            kept = [model.observe(self.points[~fold], self.field[~fold]) for fold in self.folds]
            self._grids[spacing] = (cells, elimination, kept)
        return self._grids[spacing]


def choose_spline_hyperparameters(points: Points, field: Vectors) -> Hyperparameters:
    """Numbers that predict left-out stretches of the survey best; deterministic.

    Parameters
    ----------
    points : (n, 3) array, m
    field : (n, 3) array, T

    Returns
    -------
    Hyperparameters
        ``noise_sd`` is such that 95 % intervals cover 95 % of the held-out components.
    """
    length = typical_length(points, field)
    floor = max(float(np.abs(field).max(initial=0.0)) * 1e-6, 1e-15)
    if len(points) < FEWEST_SAMPLES or length == 0 or np.ptp(field, axis=0).max() <= floor:
        return _without_evidence(points, field, length, floor)
    spacing = affordable_spacing(points, length / LENGTHSCALE_IN_SPACINGS)
    signal = float(np.sqrt(field.var(axis=0).mean()))
    noise = signal / SIGNAL_TO_NOISE
    start = Hyperparameters(max(length, 2 * spacing), signal, noise, spacing, STIFFNESS)
    search = _prepare(points, field, start)
    if not search.folds:
        return _without_evidence(points, field, length, floor)
    best = _search(search, start)
    calibrated, inflation = search.calibration(best.hyperparameters)
    noise = max(calibrated, floor)
    if has_path_order(points):
        # Along a path the nearest samples share their error (a pose that drifts, steel under the wheels): what other
        # passes miss by is the noise that a map for other surveys must reckon with.
        noise = max(noise, best.error / np.sqrt(3))
        inflation = max(1.0, inflation * calibrated / noise)
    chosen = replace(
        best.hyperparameters,
        signal_sd=signal,
        noise_sd=noise,
        looseness=best.hyperparameters.signal_sd / best.hyperparameters.noise_sd * max(calibrated, floor) / signal,
        inflation=inflation,
    )
    log.info("held-out error %.3g T with %s", best.error, chosen)
    return chosen


def _without_evidence(points: Points, field: Vectors, length: float, floor: float) -> Hyperparameters:
    """Where nothing can be left out: a broad prior about what was seen."""
    spacing = affordable_spacing(points, (length or LONELY_LENGTHSCALE) / LENGTHSCALE_IN_SPACINGS)
    signal = max(float(np.sqrt(field.var(axis=0).mean())), 10 * floor)
    return Hyperparameters(LENGTHSCALE_IN_SPACINGS * spacing, signal, signal / 10, spacing, STIFFNESS)


def _prepare(points: Points, field: Vectors, start: Hyperparameters) -> HeldOutSearch:
    """Part of the survey that can be searched fast, and what to leave out of it."""
    spacing, is_path = start.spacing, has_path_order(points)
    if is_path:
        length = min(
            SEGMENT_IN_LENGTHSCALES * start.lengthscale, SEGMENT_IN_EXTENTS * float(np.ptp(points, axis=0).max())
        )
        group = path_segments(points, length)
    else:
        group = space_blocks(points, 1.5 * spacing, np.random.default_rng(0))
    folds = [group % N_GROUPS == fold for fold in FOLDS]
    n = min(len(points), MOST_SEARCHED)
    budget = _budget(PART_OPERATIONS, n)
    part = np.ones(len(points), dtype=bool) if n == len(points) else choose_part(points, n, 3)
    for _ in range(MOST_STEPS):
        chosen = [fold[part] for fold in folds]
        usable = [fold for fold in chosen if fold.any() and not fold.all()]
        search = HeldOutSearch(points[part], field[part], usable, PATH_SCORE if is_path else BLOCK_SCORE, points)
        operations = search.operations(spacing)
        if operations <= budget:
            break
        n = max(int(n * max((budget / operations) ** 0.7, 0.1) * 0.95), FEWEST_SAMPLES)
        part = choose_part(points, n, 1 if 3 * n > len(points) else 3)
    return search


def affordable_spacing(points: Points, spacing: float) -> float:
    """A spacing, widened until the whole survey can be fitted in bounded time and memory.

    Parameters
    ----------
    points : (n, 3) array, m
    spacing : float, m
        What would be right.

    Returns
    -------
    float, m
    """
    wished = spacing
    while _operations(points, spacing) > _budget(MOST_OPERATIONS, len(points)):
        spacing *= COARSER
    if spacing > wished:
        log.warning("the survey is large: spacing widened from %.3g m to %.3g m", wished, spacing)
    return spacing


def _operations(points: Points, spacing: float) -> float:
    """Cost of one fit over the surroundings of points; infinite where the search could not lay its cells at once."""
    if np.prod(np.ptp(points, axis=0) / spacing + 2 * REACH_IN_CELLS + 1) > MAX_BOX_CELLS:
        return np.inf
    return fit_operations(points, Hyperparameters(LENGTHSCALE_IN_SPACINGS * spacing, 1.0, 1.0, spacing))


def _budget(terms: tuple[float, float], n: int) -> float:
    return terms[0] + terms[1] * n


def _search(search: HeldOutSearch, start: Hyperparameters) -> Trial:
    """Walk downhill along one number after the other, twice."""
    best = Trial(start, search.error(start))
    for _ in range(ROUNDS):
        before = best
        for name, factor, gain in MOVES:
            best = _along(search, best, name, factor, gain)
        if best.hyperparameters == before.hyperparameters:
            break
    return best


def _along(search: HeldOutSearch, best: Trial, name: str, factor: float, gain: float) -> Trial:
    """Repeat one move as long as it helps."""
    for _ in range(MOST_STEPS):
        h = replace(best.hyperparameters, **{name: getattr(best.hyperparameters, name) * factor})
        if not _is_allowed(search, h):
            break
        error = search.error(h)
        if error >= (1 - gain) * best.error:
            break
        best = Trial(h, error)
    return best


def _is_allowed(search: HeldOutSearch, h: Hyperparameters) -> bool:
    low, high = RELATIVE_LENGTHSCALES
    return (
        low <= h.lengthscale / h.spacing <= high
        and STIFFNESSES[0] <= h.stiffness <= STIFFNESSES[1]
        and search.is_affordable(h.spacing)
    )
