# SPDX-License-Identifier: BSD-3-Clause
"""`prepare`: a raw log in, a corrected survey and a report of everything that was done out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from magmatch.arguments import column_of, expect_kind
from magmatch.data.checks import require_survey
from magmatch.data.diagnoses import Diagnosis, diagnose, warn
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import SurveyError
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.earth_field import Place, earth_step
from magmatch.preparation.preparation_report import Outcome, PreparationReport, StepReport, report_on
from magmatch.preparation.sensor_estimate import estimate_sensor
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.preparation.survey_steps import find_disturbances, resampling_step, thinned
from magmatch.progress import Progress, followed, tell
from magmatch.typing import Scalars

# Why nothing is calibrated where vectors or poses are not in the frames that are declared.
WRONG_FRAME = "vectors or poses are in another frame than declared, as the warning says; no calibration corrects that"


def prepare(
    survey: Survey,
    config: PreparationConfig | None = None,
    *,
    trajectory: Trajectory | None = None,
    channels: Mapping[str, Scalars] | None = None,
    place: Place | None = None,
    sensor: SensorCorrection | None = None,
    progress: Progress | None = None,
) -> tuple[Survey, PreparationReport]:
    """Correct a log's clock and sensor, and report other suspicious samples.

    Parameters
    ----------
    survey : Survey
        As read; with orientations, since the sensor's own errors turn with it.
    config : PreparationConfig, optional
        What to do.
    trajectory : Trajectory, optional
        The poses as recorded, on their own clock; by default those of the samples.
    channels : dict of str to (n,) array, optional
        Other channels of the log, such as motor currents, one value per sample.
    place : Place, optional
        Where and when, for the check against the Earth's field.
    sensor : SensorCorrection, optional
        Known correction of the sensor, for example from another log's report; applied first, without its clock.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    survey : Survey
        Corrected; the same object if no step found anything to do.
    report : PreparationReport
        Every step with figures before and after.

    Raises
    ------
    SurveyError
        Nothing is left after removing disturbances.
    """
    require_survey(survey)
    return _prepared(survey, warn([survey]), config, trajectory, channels, place, sensor, progress)


def _prepared(
    survey: Survey,
    found: Sequence[Diagnosis],
    config: PreparationConfig | None,
    trajectory: Trajectory | None = None,
    channels: Mapping[str, Scalars] | None = None,
    place: Place | None = None,
    sensor: SensorCorrection | None = None,
    progress: Progress | None = None,
) -> tuple[Survey, PreparationReport]:
    """Prepare a survey in which these errors were found; see `prepare`."""
    why_not = WRONG_FRAME if any(one.is_of_frames for one in found) else ""
    config = config or PreparationConfig()
    expect_kind(config, "config", (PreparationConfig,))
    if trajectory is not None:
        expect_kind(trajectory, "trajectory", (Trajectory,), "Trajectory.load reads one from a TUM file")
    n = len(survey)
    channels = {name: column_of(v, f"channel {name}", "any unit", n) for name, v in (channels or {}).items()}
    given, steps = survey, list[StepReport]()
    if config.thin is not None:
        survey, channels, steps = thinned(survey, channels, config.thin)
        require_survey(survey)
    with followed(progress):
        estimated = estimate_sensor(survey, trajectory, channels, sensor, config, why_not=why_not)
        corrected, rows = estimated.correct(survey)
        readings = estimated.readings(survey)[rows]
        kept, disturbances = find_disturbances(corrected, readings, estimated.calibration, config)
    if not kept.any():
        msg = f"{survey.name}: nothing is left after removing disturbances; flag them instead of removing them"
        raise SurveyError(msg)
    left, resampled = resampling_step(corrected if kept.all() else corrected.subset(kept), config)
    steps += [*estimated.steps(config), *disturbances, resampled, earth_step(left.field, place)]
    return left, report_on(given, left, steps, estimated.whole_model, config)


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
    require_survey(raw)
    # Wrong frames are told of the phone's own; that raw readings are of another size than on Earth is their offset.
    done = {"the phone's own": prepare(own, config, **known), "raw": _prepared(raw, diagnose(raw), config, **known)}
    before, after = (_held_out(report) for _, report in done.values())
    open_axes = _open_axes(done["raw"][1])
    if open_axes or before is None or after is None:
        taken, why = "the phone's own", f"the motion does not determine the raw ones' bias{open_axes}"
    else:
        taken = "raw" if after < before else "the phone's own"
        why = (
            f"a map misses left-out stretches by {before:.3g} uT with the phone's own, by {after:.3g} uT with the raw"
        )
    outcome: Outcome = "applied" if taken == "raw" else "unchanged"
    figures = {"taken": taken.removeprefix("the phone's "), "held_out": [before, after]}
    words = f"readings taken: {taken}; {why}"
    step = StepReport("magnetometer", outcome, words, before, after, "uT", figures)
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
