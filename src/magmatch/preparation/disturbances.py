# SPDX-License-Identifier: BSD-3-Clause
"""Samples that do not measure the ambient field: spikes, drop-outs, saturation, and metal that moved."""

import numpy as np
from scipy.ndimage import label, median_filter
from scipy.special import chdtri

from magmatch.data.sensor_axes import FEW, at_limit
from magmatch.estimation.gauss_newton import student_weights
from magmatch.field.folds import has_path_order, path_segments
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.preparation.consistency import MapConsistency
from magmatch.preparation.least_squares import MEDIAN_TO_SD, ROUNDS, SMALLEST_NOISE, robust_sd
from magmatch.typing import Mask, Points, Scalars, Tensors, Vectors

# Readings to either side that a spike is held against; up to two in a row still stand out.
NEIGHBOURS = 3
# Metal that moved: median residual of a run, in standard deviations, and the run's length.
CONTRADICTION, FEWEST_IN_RUN = 4.0, 9
# Groups by steepness of the field, whose residuals tell how errors grow with it.
N_GROUPS = 10
# Stretches are trusted or not as a whole, in so many rounds.
STRETCH_IN_LENGTHSCALES, ROUNDS_OF_TRUST = 0.5, 8


def find_jumps(readings: Vectors, threshold: float) -> Mask:
    """Readings that differ from those just before and after."""
    if len(readings) < 2 * NEIGHBOURS + 1:
        return np.zeros(len(readings), dtype=bool)
    among = median_filter(readings, size=(2 * NEIGHBOURS + 1, 1), mode="nearest")
    difference = readings - among
    spread = np.maximum(MEDIAN_TO_SD * np.median(np.abs(difference), axis=0), 1e-12 * np.abs(readings).max(axis=0))
    return np.asarray((np.abs(difference) > threshold * np.maximum(spread, 1e-300)).any(axis=1))


def find_spikes(
    points: Points, field: Vectors, hyperparameters: Hyperparameters, threshold: float, *, in_order: bool
) -> Mask:
    """Samples that neither a map of the others nor, along a path, their neighbours explain."""
    weights = np.ones(len(points))
    for _ in range(ROUNDS):
        residual = MapConsistency(points, hyperparameters, weights).project(field[None])[1][0]
        sd = robust_sd(residual)
        weights = student_weights((residual**2).sum(axis=1) / sd**2, 3)
    is_odd: Mask = np.abs(residual).max(axis=1) > threshold * sd
    return is_odd & find_jumps(field, threshold) if in_order else is_odd


def find_saturation(readings: Vectors) -> Mask:
    """Readings of which a component is at the end of the sensor's range."""
    return np.asarray(at_limit(readings).any(axis=1))


def find_contradictions(points: Points, field: Vectors, hyperparameters: Hyperparameters) -> Mask:
    """Runs of samples that contradict other passes of the same places: metal that moved, or poses that did."""
    is_contradicted = np.zeros(len(points), dtype=bool)
    if not has_path_order(points):
        return is_contradicted
    stretch = path_segments(points, STRETCH_IN_LENGTHSCALES * hyperparameters.lengthscale)
    counts = np.bincount(stretch)
    trust = np.ones(len(points))
    for _ in range(ROUNDS_OF_TRUST):
        consistency = MapConsistency(points, hyperparameters, trust)
        residual = consistency.project(field[None])[1][0]
        sd = _ordinary_sd(residual, consistency.gradient(field))
        square = np.bincount(stretch, (residual**2).mean(axis=1) / sd**2) / np.maximum(counts, 1)
        # A stretch that disagrees counts less as a whole, so that those it contradicts decide what the field is.
        trust = (2 / (1 + square))[stretch]
    smooth = median_filter(np.abs(residual).max(axis=1) / sd, size=FEWEST_IN_RUN, mode="nearest")
    return np.asarray(smooth > CONTRADICTION)


def runs(mask: Mask, times: Scalars | None) -> list[list[float]]:
    """First and last sample of each run (times where there are any, else numbers)."""
    numbered, n_runs = label(mask)
    found = [np.flatnonzero(numbered == k)[[0, -1]] for k in range(1, min(n_runs, 100) + 1)]
    return [[float(times[i]) if times is not None else float(i) for i in ends] for ends in found]


def _ordinary_sd(residual: Vectors, gradient: Tensors) -> Scalars:
    """Spread of a component where nothing moved: (n,), T. Errors of poses and map grow with the field's steepness."""
    if len(residual) < FEW * N_GROUPS:
        return np.full(len(residual), robust_sd(residual))
    steepness = np.linalg.norm(gradient, axis=(1, 2))
    size = np.linalg.norm(residual, axis=1) / np.sqrt(chdtri(3, 0.5))
    # Medians of groups and over groups, so that no one place where something moved decides.
    groups = np.array_split(np.argsort(steepness, kind="stable"), N_GROUPS)
    sd, steep = (np.array([np.median(values[group]) for group in groups]) for values in (size, steepness))
    half = N_GROUPS // 2
    flat = max(float(np.median(sd[:half])), SMALLEST_NOISE)
    slope = float(np.median(np.sqrt(np.maximum(sd[half:] ** 2 - flat**2, 0)) / np.maximum(steep[half:], 1e-300)))
    return np.asarray(np.hypot(flat, slope * steepness))
