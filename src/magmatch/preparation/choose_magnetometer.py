# SPDX-License-Identifier: BSD-3-Clause
"""The choice of a phone's readings: those with its own calibration, or the raw ones, calibrated here."""

from dataclasses import replace
from typing import Any

from magmatch.data.survey import Survey
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.preparation_report import PreparationReport, StepReport
from magmatch.preparation.prepare import prepare
from magmatch.progress import tell


def prepare_either(
    own: Survey, raw: Survey | None, config: PreparationConfig | None = None, **known: Any
) -> tuple[Survey, PreparationReport]:
    """Prepare both kinds of readings of a phone and return the better one, with a report that says which and why.

    Parameters
    ----------
    own : Survey
        With the phone's own calibration, which may jump and may be wrong.
    raw : Survey, optional
        Without it, so with a constant bias to be estimated, often of tens of uT. None: there is no choice.
    config, **known
        As in `magmatch.prepare`, for either.

    Notes
    -----
    The one that a map predicts better on held-out stretches after calibration is used; the phone's own if the motion
    does not determine the raw readings' bias in all three directions, since they could not be used elsewhere.
    The report's first step, ``magnetometer``, holds the misfit of both.
    """
    if raw is None:
        return prepare(own, config, **known)
    tell("preparing the phone's own readings, then the raw ones")
    done = {"the phone's own": prepare(own, config, **known), "raw": prepare(raw, config, **known)}
    reports = {name: report for name, (_, report) in done.items()}
    misfit = {name: _held_out(report) for name, report in reports.items()}
    before, after = misfit.values()
    open_axes = _open_axes(reports["raw"])
    if open_axes or before is None or after is None:
        taken, why = "the phone's own", f"the motion does not determine the raw ones' bias{open_axes}"
    else:
        taken = min(misfit, key=lambda name: float(misfit[name] or 0.0))
        why = (
            f"a map misses left-out stretches by {before:.3g} uT with the phone's own, by {after:.3g} uT with the raw"
        )
    words = f"readings taken: {taken}; {why}"
    step = StepReport(
        "magnetometer", "unchanged" if taken != "raw" else "applied", words, before, after, "uT",
        {"taken": "own" if taken != "raw" else "raw", "held_out": [before, after]},
    )  # fmt: skip
    survey, report = done[taken]
    return survey, replace(report, steps=(step, *report.steps))


def _held_out(report: PreparationReport) -> float | None:
    """Median error on held-out stretches after calibration, uT; None if there was none."""
    return next((step.after for step in report.steps if step.step == "all corrections"), None)


def _open_axes(report: PreparationReport) -> str:
    """Directions in which the bias stays unknown, in words; nothing where all are told."""
    step = next((step for step in report.steps if step.step == "hard iron"), None)
    if step is None or "is_open" not in step.figures:
        return " at all"
    axes = [axis for axis, is_open in zip("xyz", step.figures["is_open"], strict=True) if is_open]
    return f" along {', '.join(axes)}" if axes else ""
