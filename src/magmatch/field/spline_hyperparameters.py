# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of the spline prior: by tempered evidence on a part of the survey, its noise by other passes."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmatch.field.affordability import affordable_spacing, is_affordable
from magmatch.field.held_out import choose_part, has_path_order, typical_length
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.other_passes import OtherPasses
from magmatch.field.spline_evidence import EvidenceSearch
from magmatch.typing import Points, Vectors

log = logging.getLogger(__name__)

FEWEST_SAMPLES = 40
# Where all samples lie at one place, m.
LONELY_LENGTHSCALE = 0.5
# The search starts here: spacing and lengthscale from the variogram, signal over noise and stiffness that suit most;
# along a path a field so smooth that what it leaves shows which errors neighbours share.
LENGTHSCALE_IN_SPACINGS = 4.0
START, START_OF_A_PATH = (36.0, 3000.0), (12.0, 300.0)
# Samples anywhere in a volume fill it; the lanes of a path leave gaps, which the basis has to bridge.
REACH, REACH_OF_A_PATH = 1.5, 2.0
# Moves tried in turn, each repeated as long as the evidence grows: what is multiplied, and by which factors (the
# second where the first does not help). Spacings only shrink: coarser splines can but hide what finer ones show.
Moves = Sequence[tuple[str, Sequence[float]]]
COARSE_MOVES: Moves = (("noise_sd", (3.0, 1 / 3.0)), ("stiffness", (10.0, 0.1)), ("lengthscale", (1.8, 1 / 1.8)))
FINE_MOVES: Moves = (("spacing", (0.75,)), ("noise_sd", (1.7, 1 / 1.7)))
# A move must gain so many nats: less is chance, and the start is a good one.
LEAST_GAIN = 2.0
ROUNDS, MOST_STEPS = 3, 6
# Bounds of lengthscale over spacing, stiffness, signal over noise.
RELATIVE_LENGTHSCALES, STIFFNESSES, SIGNALS_TO_NOISE = (1.5, 12.0), (3.0, 3001.0), (0.3, 1e5)
# Operations of one factorisation of the part that is searched: a constant and a share per sample. Of a path it has to
# hold many lanes that cross: from few, nothing tells what they miss of one another.
PART_OPERATIONS, PART_OF_A_PATH = (6e8, 1.5e5), (5e8, 1.5e5)
# Of a short path, as many as this, and less than a share of any tells too little: so many may be spent on that.
LEAST_OPERATIONS, SHARE_OF_A_PATH, SHARE_OPERATIONS = 3e9, 0.3, 8e9
# The same of a smaller part, from which the coarse moves can be told where samples lie anywhere.
FEW_OPERATIONS = (1e8, 3e4)
FEWEST_OF_A_PART, MOST_SEARCHED, MOST_CUTS = 300, 50_000, 4
# The posterior is made a little wider than it says of itself: its numbers are themselves estimates.
LEAST_INFLATION = 1.3


@dataclass(frozen=True, slots=True)
class Trial:
    """One point of the search."""

    hyperparameters: Hyperparameters
    log_evidence: float


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
    start = _start(points, field, length)
    if has_path_order(points):
        search = _search_of_a_part(points, field, start, PART_OF_A_PATH, SHARE_OF_A_PATH)
        search.samples_as_one = max(search.correlated_samples(start), search.crowded_samples(start))
        best = _climb(search, start, (*COARSE_MOVES, *FINE_MOVES), points)
        passes = OtherPasses(search.points, search.field, start.lengthscale)
    else:
        few = _search_of_a_part(points, field, start, FEW_OPERATIONS)
        search, passes = _search_of_a_part(points, field, start, PART_OPERATIONS), None
        best = _climb(search, _climb(few, start, COARSE_MOVES, points), FINE_MOVES, points)
    noise, inflation = max(search.noise_sd(best), floor), LEAST_INFLATION
    if passes is not None and passes.tell_something:
        # Along a path the nearest samples share their error: what other passes miss by is the noise that a map for
        # other surveys must reckon with.
        alone, noise = noise, max(noise, passes.error(best))
        inflation = passes.inflation(_with_noise(best, alone), noise) * alone / noise
    chosen = replace(_with_noise(best, noise), inflation=max(LEAST_INFLATION, inflation))
    log.info("%.0f samples count as one, %s", search.samples_as_one, chosen)
    return chosen


def _with_noise(h: Hyperparameters, noise_sd: float) -> Hyperparameters:
    """The same map from the same samples, with another statement of their noise."""
    return replace(h, noise_sd=noise_sd, looseness=h.looseness * noise_sd / h.noise_sd)


def _start(points: Points, field: Vectors, length: float) -> Hyperparameters:
    """Where the search starts: the scale at which the field changes, and the spacing the survey can afford."""
    signal = float(np.sqrt(field.var(axis=0).mean()))
    reach, (ratio, stiffness) = (REACH_OF_A_PATH, START_OF_A_PATH) if has_path_order(points) else (REACH, START)
    start = Hyperparameters(
        length / 1.5, signal, signal / ratio, length / LENGTHSCALE_IN_SPACINGS, stiffness, reach=reach
    )
    spacing = _rounded(affordable_spacing(points, start))
    lengthscale = _rounded(max(start.lengthscale, 2 * spacing))
    return replace(start, spacing=spacing, lengthscale=lengthscale, noise_sd=_rounded(start.noise_sd))


def _rounded(value: float) -> float:
    """A number that is the same again after a move there and back, so that nothing is computed twice."""
    return float(f"{value:.10g}")


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


def _search_of_a_part(
    points: Points, field: Vectors, start: Hyperparameters, operations: tuple[float, float], share: float = 0.0
) -> EvidenceSearch:
    """Search over a part of the survey, small enough to be fast, and a share of it where that can be."""
    n = min(len(points), MOST_SEARCHED)
    part = np.ones(len(points), dtype=bool) if n == len(points) else choose_part(points, n, 3)
    budget, least = operations[0] + operations[1] * n, int(share * n)
    budget = max(budget, LEAST_OPERATIONS) if share else budget
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


def _climb(search: EvidenceSearch, start: Hyperparameters, moves: Moves, whole: Points) -> Hyperparameters:
    """Walk uphill along one number after the other, until a round finds nothing better."""
    best = Trial(start, search.log_evidence(start))
    for _ in range(ROUNDS):
        before = best
        for name, factors in moves:
            best = _along(search, best, name, factors, whole)
        if best == before:
            break
    return best.hyperparameters


def _along(search: EvidenceSearch, start: Trial, name: str, factors: Sequence[float], whole: Points) -> Trial:
    """Repeat the first of some moves that helps, as long as it does."""
    best = start
    for factor in factors:
        for _ in range(MOST_STEPS):
            h = replace(best.hyperparameters, **{name: _rounded(getattr(best.hyperparameters, name) * factor)})
            if not _is_allowed(h) or (name == "spacing" and not is_affordable(whole, h)):
                break
            evidence = search.log_evidence(h)
            if evidence < best.log_evidence + LEAST_GAIN:
                break
            best = Trial(h, evidence)
        if best is not start:
            break
    return best


def _is_allowed(h: Hyperparameters) -> bool:
    return (
        RELATIVE_LENGTHSCALES[0] <= h.lengthscale / h.spacing <= RELATIVE_LENGTHSCALES[1]
        and STIFFNESSES[0] <= h.stiffness <= STIFFNESSES[1]
        and SIGNALS_TO_NOISE[0] <= h.signal_sd / h.noise_sd <= SIGNALS_TO_NOISE[1]
    )
