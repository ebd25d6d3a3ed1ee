# SPDX-License-Identifier: BSD-3-Clause
"""Steps that look at the corrected survey, disturbances and resampling, each with its report."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.checks import time_gaps
from magmatch.data.sensor_axes import find_repeats
from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.preparation.calibrate_on_map import CalibrationEstimate
from magmatch.preparation.config import Flagging, PreparationConfig
from magmatch.preparation.consistency import affordable
from magmatch.preparation.disturbances import find_contradictions, find_saturation, find_spikes, runs
from magmatch.preparation.preparation_report import Outcome, StepReport
from magmatch.progress import tell
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors


def thinned(
    survey: Survey, channels: Mapping[str, Scalars], step: float
) -> tuple[Survey, dict[str, Scalars], list[StepReport]]:
    """The first sample of each step of the way (m), untouched: what is read more closely tells a map no more."""
    rows = np.flatnonzero(np.diff(steps_of(survey.positions, step), prepend=-1))
    words = f"the first sample of each {step:g} m of the way"
    report = StepReport("thinning", "applied", words, len(survey), len(rows), "samples")
    return survey.subset(rows), {name: values[rows] for name, values in channels.items()}, [report]


@single_threaded
def find_disturbances(
    survey: Survey, readings: Vectors, calibration: CalibrationEstimate | None, config: PreparationConfig
) -> tuple[Mask, list[StepReport]]:
    """Choose the samples to keep, and report each kind of disturbance."""
    modes, in_order = config.disturbances, survey.times is not None
    h = cache(partial(_hyperparameters, survey, calibration, config))
    kept, steps = np.ones(len(survey), dtype=bool), []
    gaps, at = time_gaps(survey), (survey.positions, survey.field)
    gap_words = f"; {len(gaps)} gaps in time, the longest {gaps.max():.3g} s" if len(gaps) else ""
    found: dict[str, tuple[Flagging, Callable[[], Mask], str]] = {
        "drop-outs": (modes.drop_outs, lambda: find_repeats(readings), "readings equal the previous one" + gap_words),
        "saturation": (modes.saturation, lambda: find_saturation(readings),
                       "readings at the end of the sensor's range"),
        "spikes": (modes.spikes, lambda: find_spikes(*at, h(), modes.spike_threshold, in_order=in_order),
                   "samples fit neither their neighbours nor the map"),
        "moving metal": (modes.moving_metal, lambda: find_contradictions(*at, h()),
                         "samples contradict other passes of the same places"),
    }  # fmt: skip
    for name, (mode, find, words) in found.items():
        if mode == "off":
            steps.append(StepReport(name, "off", ""))
            continue
        tell(f"looking for {name}")
        mask = find()
        steps.append(_disturbance_step(name, mode, mask, words, survey))
        if mode == "remove":
            kept &= ~mask
    return kept, steps


def resampling_step(survey: Survey, config: PreparationConfig) -> tuple[Survey, StepReport]:
    """Resample by distance where asked for."""
    step = config.resampling.step
    if step is None:
        return survey, StepReport("resampling", "off", "every sample is kept")
    resampled = resample_by_distance(survey, step, config.resampling.average)
    words = f"{config.resampling.average} of each {step:g} m of the way"
    return resampled, StepReport("resampling", "applied", words, len(survey), len(resampled), "samples")


def _hyperparameters(
    survey: Survey, calibration: CalibrationEstimate | None, config: PreparationConfig
) -> Hyperparameters:
    """Settings of the map that samples are held against."""
    if calibration is not None and not calibration.refused:
        h = calibration.hyperparameters
    else:
        stride = -(-len(survey) // config.n_samples)
        h = choose_spline_hyperparameters(survey.positions[::stride], survey.field[::stride])
    return affordable(survey.positions, h)


def _disturbance_step(name: str, mode: Flagging, mask: Mask, words: str, survey: Survey) -> StepReport:
    count = int(mask.sum())
    if count == 0 and ";" not in words:
        return StepReport(name, "unchanged", "none found", 0, 0, "samples")
    outcome: Outcome = "unchanged" if count == 0 else "applied" if mode == "remove" else "flagged"
    text = f"{count} {words}" + ("; left out" if outcome == "applied" else "; kept" if count else "")
    figures = {"runs": runs(mask, survey.times), "share": count / max(len(survey), 1)}
    return StepReport(name, outcome, text, count, 0 if outcome == "applied" else count, "samples", figures)


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
