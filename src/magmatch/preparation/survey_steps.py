# SPDX-License-Identifier: BSD-3-Clause
"""Steps that look at the corrected survey: disturbances, resampling, the Earth's field; each with its report."""

import numpy as np

from magmatch.data.checks import time_gaps
from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.preparation.calibration import Calibration
from magmatch.preparation.config import Flagging, PreparationConfig
from magmatch.preparation.disturbances import (
    find_contradictions,
    find_repeats,
    find_saturation,
    find_spikes,
    runs,
)
from magmatch.preparation.earth_field import Place, check_earth_field
from magmatch.preparation.preparation_report import Outcome, StepReport
from magmatch.preparation.resampling import resample_by_distance
from magmatch.threads import single_threaded
from magmatch.typing import Mask, Vectors

OFF = "off"


@single_threaded
def find_disturbances(
    survey: Survey, readings: Vectors, calibration: Calibration | None, config: PreparationConfig
) -> tuple[Mask, list[StepReport]]:
    """Which samples to keep, and a report of each kind of disturbance."""
    modes, in_order = config.disturbances, survey.times is not None
    hyperparameters = _hyperparameters(survey, calibration, config)
    kept, steps = np.ones(len(survey), dtype=bool), []
    gaps = time_gaps(survey)
    gap_words = f"; {len(gaps)} gaps in time, the longest {gaps.max():.3g} s" if len(gaps) else ""
    found: list[tuple[str, Flagging, Mask | None, str]] = [
        ("drop-outs", modes.drop_outs, find_repeats(readings), "readings equal the previous one" + gap_words),
        ("saturation", modes.saturation, find_saturation(readings), "readings at the end of the sensor's range"),
        ("spikes", modes.spikes, None, "samples fit neither their neighbours nor the map"),
        ("moving metal", modes.moving_metal, None, "samples contradict other passes of the same places"),
    ]
    for name, mode, given, words in found:
        mask = given
        if mode != OFF and given is None:
            mask = _held_against_map(name, survey, hyperparameters, config, in_order=in_order)
        step = _disturbance_step(name, mode, mask, words, survey)
        if mode == "remove" and mask is not None:
            kept &= ~mask
        steps.append(step)
    return kept, steps


def resampling_step(survey: Survey, config: PreparationConfig) -> tuple[Survey, StepReport]:
    """Resample by distance where asked for."""
    step = config.resampling.step
    if step is None:
        return survey, StepReport("resampling", "off", "every sample is kept")
    resampled = resample_by_distance(survey, step, config.resampling.average)
    words = f"{config.resampling.average} of each {step:g} m of the way"
    return resampled, StepReport("resampling", "applied", words, len(survey), len(resampled), "samples")


def earth_step(survey: Survey, place: Place | None) -> StepReport:
    """Compare with the Earth's field where place and date are known."""
    if place is None:
        return StepReport("earth field", "off", "no place and date given")
    check = check_earth_field(survey.field, place)
    outcome: Outcome = "unchanged" if check.is_plausible else "flagged"
    return StepReport("earth field", outcome, check.words, figures=check.figures())


def _hyperparameters(
    survey: Survey, calibration: Calibration | None, config: PreparationConfig
) -> Hyperparameters | None:
    """Settings of the map that samples are held against; None where no step needs one."""
    if config.disturbances.spikes == OFF and config.disturbances.moving_metal == OFF:
        return None
    if calibration is not None and not calibration.is_refused:
        return calibration.hyperparameters
    stride = -(-len(survey) // config.n_samples)
    return choose_spline_hyperparameters(survey.positions[::stride], survey.field[::stride])


def _held_against_map(
    name: str, survey: Survey, hyperparameters: Hyperparameters | None, config: PreparationConfig, *, in_order: bool
) -> Mask:
    assert hyperparameters is not None
    if name == "moving metal":
        return find_contradictions(survey.positions, survey.field, hyperparameters)
    threshold = config.disturbances.spike_threshold
    return find_spikes(survey.positions, survey.field, hyperparameters, threshold, in_order=in_order)


def _disturbance_step(name: str, mode: Flagging, mask: Mask | None, words: str, survey: Survey) -> StepReport:
    if mode == OFF or mask is None:
        return StepReport(name, "off", "")
    count = int(mask.sum())
    if count == 0 and ";" not in words:
        return StepReport(name, "unchanged", "none found", 0, 0, "samples")
    outcome: Outcome = "unchanged" if count == 0 else "applied" if mode == "remove" else "flagged"
    text = f"{count} {words}" + ("; left out" if outcome == "applied" else "; kept" if count else "")
    figures = {"runs": runs(mask, survey.times), "share": count / max(len(survey), 1)}
    return StepReport(name, outcome, text, count, 0 if outcome == "applied" else count, "samples", figures)
