# SPDX-License-Identifier: BSD-3-Clause
"""`prepare`: a raw log in, a corrected survey and a report of everything that was done out."""

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from magmatch._version import __version__
from magmatch.arguments import column_of, expect_kind
from magmatch.data.checks import require_survey
from magmatch.data.diagnoses import warn
from magmatch.data.fingerprint import hash_survey
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import SurveyError
from magmatch.preparation.calibration import calibrate
from magmatch.preparation.calibration_steps import calibration_steps, known_sensor_step
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.disturbances import find_jumps, find_repeats, find_saturation
from magmatch.preparation.earth_field import Place, earth_step
from magmatch.preparation.preparation_report import PreparationReport
from magmatch.preparation.recalibrations import NO_CUTS, find_recalibrations, recalibration_step
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import SensorModel
from magmatch.preparation.survey_steps import find_disturbances, resampling_step
from magmatch.progress import Progress, followed
from magmatch.typing import Indices, Mask, Scalars

log = logging.getLogger(__name__)


def prepare(
    survey: Survey,
    config: PreparationConfig | None = None,
    *,
    trajectory: Trajectory | None = None,
    channels: Mapping[str, Scalars] | None = None,
    place: Place | None = None,
    sensor: SensorModel | None = None,
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
    sensor : SensorModel, optional
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
    warn([survey])
    config, channels = config or PreparationConfig(), channels or {}
    expect_kind(config, "config", (PreparationConfig,))
    if trajectory is not None:
        expect_kind(trajectory, "trajectory", (Trajectory,), "Trajectory.load reads one from a TUM file")
    channels = {
        name: column_of(values, f"channel {name}", "any unit", len(survey)) for name, values in channels.items()
    }
    sensor_log = None if survey.orientations is None else SensorLog.of(survey, trajectory)
    if sensor is not None:
        if sensor_log is None:
            msg = f"{survey.name}: a known correction of the sensor needs orientations to be made"
            raise SurveyError(msg)
        sensor_log = replace(sensor_log, readings=sensor.corrected(sensor_log.readings))
    calibration, cuts, every = None, NO_CUTS, dict(channels)
    if sensor_log is not None:
        if config.recalibration == "auto":
            cuts = find_recalibrations(sensor_log)
        if len(cuts):
            sensor_log = cuts.joined(sensor_log)
            every |= cuts.channels(len(sensor_log))
        with followed(progress):
            calibration = calibrate(sensor_log, config, every, trusted(sensor_log, config))
    steps = [known_sensor_step(sensor)]
    steps += [recalibration_step(cuts, sensor_log, calibration)] if config.recalibration == "auto" else []
    steps += calibration_steps(survey, sensor_log, calibration, config, channels)
    model = SensorModel() if calibration is None else calibration.model
    is_changed = sensor is not None or len(cuts) > 0
    corrected, rows = apply_model(survey, sensor_log, model, every, is_changed=is_changed)
    readings = survey.field[rows] if sensor_log is None else sensor_log.readings[rows]
    kept, found = find_disturbances(corrected, readings, calibration, config)
    steps += found
    left = corrected if kept.all() else corrected.subset(kept)
    if len(left) == 0:
        msg = f"{survey.name}: nothing is left after removing disturbances; flag them instead of removing them"
        raise SurveyError(msg)
    left, resampled = resampling_step(left, config)
    steps += [resampled, earth_step(left.field, place)]
    report = PreparationReport(
        survey.name, (len(survey), len(left)), tuple(steps), config.model_dump(mode="json"),
        model if sensor is None else model.after(sensor), ({"name": survey.name, "sha256": hash_survey(survey)},),
        __version__,
    )  # fmt: skip
    return left, report


def trusted(sensor_log: SensorLog, config: PreparationConfig) -> Mask:
    """Readings used for estimates: without jumps, repeats or saturation, whatever is done about these later."""
    readings = sensor_log.readings
    is_bad = (
        find_jumps(readings, config.disturbances.spike_threshold)
        if sensor_log.times is not None
        else np.zeros(len(readings), dtype=bool)
    )
    return np.asarray(~(is_bad | find_repeats(readings) | find_saturation(readings)))


def apply_model(
    survey: Survey, sensor_log: SensorLog | None, model: SensorModel, channels: Mapping[str, Scalars], *,
    is_changed: bool,
) -> tuple[Survey, Indices]:  # fmt: skip
    """Correct all samples of a survey; also gives the rows that still have a pose once their stamps are moved.

    If there is nothing to correct, the same survey is returned. `is_changed`: the log's readings differ from the
    survey's.
    """
    every = np.arange(len(survey))
    if sensor_log is None or (model.is_identity and not is_changed):
        return survey, every
    rows = every if model.time_offset == 0 else np.flatnonzero(sensor_log.covered(model.time_offset))
    part = sensor_log.subset(rows)
    positions, orientations = part.at(model.time_offset)
    field = orientations.apply(model.corrected(part.readings, {k: v[rows] for k, v in channels.items()}))
    times = None if survey.times is None else survey.times[rows] + model.time_offset
    return replace(survey, positions=positions, field=field, times=times, orientations=orientations), rows
