# SPDX-License-Identifier: BSD-3-Clause
"""The estimate of a log's own sensor: known beforehand, recalibrated by the phone itself, calibrated here."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from magmatch.data.sensor_axes import find_repeats, stuck_axes
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import SurveyError
from magmatch.preparation.calibrate_on_map import CalibrationEstimate, calibrate
from magmatch.preparation.calibration_steps import calibration_steps, known_sensor_step
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.disturbances import find_jumps, find_saturation
from magmatch.preparation.preparation_report import StepReport
from magmatch.preparation.recalibrations import NO_CUTS, Recalibrations, find_recalibrations, recalibration_step
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import SensorCorrection, why_no_field
from magmatch.typing import Indices, Mask, Scalars, Vectors

# m and rad: the jitter of poses at rest. A carrier that moves or turns by less shows no error of its sensor or clock.
STILL, UNTURNED = 0.05, 0.1


@dataclass(frozen=True, eq=False, slots=True)
class SensorEstimate:
    """The errors of a log's clock and sensor."""

    known: SensorCorrection | None  # correction known beforehand; `log` has it
    log: SensorLog | None  # none without orientations, with which the sensor's errors turn
    cuts: Recalibrations  # where the phone recalibrated itself; `log` has them joined
    calibration: CalibrationEstimate | None
    channels: Mapping[str, Scalars]  # other channels of the log
    why_not: str = ""  # why nothing was estimated, in words

    @property
    def model(self) -> SensorCorrection:
        """The model that was estimated."""
        return SensorCorrection() if self.calibration is None else self.calibration.model

    @property
    def whole_model(self) -> SensorCorrection:
        """The model that was estimated, after what was known."""
        return self.model if self.known is None else self.model.after(self.known)

    def readings(self, survey: Survey) -> Vectors:
        """The readings as the sensor gave them, but for what was known; the survey's field without orientations."""
        return survey.field if self.log is None else self.log.readings

    def correct(self, survey: Survey) -> tuple[Survey, Indices]:
        """Correct a survey; see `apply_model`."""
        is_changed = self.known is not None or len(self.cuts) > 0
        every = {**self.channels, **self.cuts.channels(len(survey))}
        return apply_model(survey, self.log, self.model, every, is_changed=is_changed)

    def steps(self, config: PreparationConfig) -> list[StepReport]:
        """The steps that were taken, in order."""
        joined = [recalibration_step(self.cuts, self.log, self.calibration)] if config.recalibration == "auto" else []
        found = calibration_steps(self.log, self.calibration, config, self.channels, self.why_not)
        return [known_sensor_step(self.known), *joined, *found]


def estimate_sensor(
    survey: Survey,
    trajectory: Trajectory | None,
    channels: Mapping[str, Scalars],
    known: SensorCorrection | None,
    config: PreparationConfig,
    *,
    why_not: str = "",
) -> SensorEstimate:
    """Take off what is known, join what the phone recalibrated, and calibrate what is left.

    `why_not` says why nothing can be calibrated: vectors in a wrong frame are not the sensor's readings.
    """
    if survey.orientations is None:
        if known is not None:
            msg = f"{survey.name}: a known correction of the sensor needs orientations to be made"
            raise SurveyError(msg)
        return SensorEstimate(None, None, NO_CUTS, None, channels)
    sensor_log = SensorLog.of(survey, trajectory)
    if known is not None:
        sensor_log = replace(sensor_log, readings=known.corrected(sensor_log.readings))
    if why_not := why_not or _why_no_estimate(survey):
        return SensorEstimate(known, sensor_log, replace(NO_CUTS, refused=why_not), None, channels, why_not)
    cuts = find_recalibrations(sensor_log) if config.recalibration == "auto" else NO_CUTS
    joined = cuts.joined(sensor_log) if len(cuts) else sensor_log
    if why := why_no_field(*(log.orientations.apply(log.readings) for log in (sensor_log, joined))):
        cuts, joined = cuts.withdrawn(why), sensor_log
    every, is_good = {**channels, **cuts.channels(len(joined))}, trusted(joined, config)
    calibration = calibrate(joined, config, every, is_good)
    why_not = (
        f"too few samples to tell: {is_good.sum()} of {len(survey)} are not held, at the end of the range or spikes"
    )
    estimate = SensorEstimate(known, joined, cuts, calibration, channels, why_not)
    if calibration is None:
        return estimate
    # What is about to be written, against what was read.
    corrected, rows = estimate.correct(survey)
    why = why_no_field(sensor_log.orientations[rows].apply(sensor_log.readings[rows]), corrected.field)
    return replace(estimate, calibration=calibration.withdrawn(why))


def _why_no_estimate(survey: Survey) -> str:
    """Say what makes every estimate of a sensor's errors meaningless; nothing if nothing does."""
    if stuck := stuck_axes(survey):
        return "; ".join(stuck)
    assert survey.orientations is not None  # or nothing is estimated in any case
    moved = np.ptp(np.quantile(survey.positions, [0.01, 0.99], axis=0), axis=0).max()
    turned = np.quantile((survey.orientations[len(survey) // 2].inv() * survey.orientations).magnitude(), 0.99)
    if moved < STILL and turned < UNTURNED:
        most = f"within {100 * STILL:.0f} cm and {np.degrees(UNTURNED):.0f} deg"
        return f"the sensor does not move ({most}): nothing tells its errors from the field of the place"
    return ""


def trusted(sensor_log: SensorLog, config: PreparationConfig) -> Mask:
    """Readings used for estimates: without jumps, repeats or saturation, whatever is done about these later."""
    readings = sensor_log.readings
    is_bad = find_repeats(readings) | find_saturation(readings)
    if sensor_log.times is not None:
        is_bad |= find_jumps(readings, config.disturbances.spike_threshold)
    return np.asarray(~is_bad)


def apply_model(
    survey: Survey, sensor_log: SensorLog | None, model: SensorCorrection, channels: Mapping[str, Scalars], *,
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
