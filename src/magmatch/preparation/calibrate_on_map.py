# SPDX-License-Identifier: BSD-3-Clause
"""Clock and sensor errors from the motion itself: passes of one place at any heading must see one field."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from magmatch.estimation.gauss_newton import student_weights
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.preparation.config import PreparationConfig, Switch
from magmatch.preparation.consistency import MapConsistency, affordable, held_out_error
from magmatch.preparation.least_squares import ParameterBlock, Solution, System
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import (
    CHANNEL,
    EXPECTED_SD,
    PIECE,
    SensorCorrection,
    channel_blocks,
    model_of,
    sensor_blocks,
    why_no_sensor,
)
from magmatch.preparation.time_offset import coarse_settings, search_time_offset
from magmatch.progress import tell
from magmatch.threads import single_threaded
from magmatch.typing import Mask, Scalars, Vectors

# s; loggers' offsets are of this order. What is known worse than half of it is not known.
TIME_OFFSET_SD = 0.1
# T, of a disturbance by one standard deviation of a channel.
CHANNEL_SD = 5e-6
MOST_STEPS = 8
# Steps of the clock, in its standard deviations, that no data could tell from none.
CONVERGED = 0.1
FEWEST_READINGS = 100


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationEstimate:
    """Estimated errors of clock and sensor."""

    model: SensorCorrection  # the correction; the identity if nothing was significant
    full: Solution  # all unknowns together, before insignificant ones were dropped
    chosen: Solution  # those that were kept
    # T: inconsistency that would remain without each of those kept (root mean square of a component)
    without: Mapping[str, float]
    watched: Mapping[str, Solution]  # what was kept and one channel that is reported but not removed, by its block
    # (float, float), T: of the log as it is, and with the correction; against maps of the same settings
    inconsistency: tuple[float, float]
    hyperparameters: Hyperparameters  # of the map that everything was held against
    refused: str = ""  # why the correction was withdrawn, in words; empty if it was not
    # s: an offset of the clocks beyond those that were searched, which is none
    beyond: float | None = None
    # (float, float), T: median error of a map on held-out stretches, as read and with the correction
    held_out: tuple[float, float] = (0.0, 0.0)

    def withdrawn(self, why: str) -> "CalibrationEstimate":
        """Drop the correction, if there is a reason in words."""
        return replace(self, model=SensorCorrection(), refused=why) if why else self


@single_threaded
def calibrate(
    sensor_log: SensorLog, config: PreparationConfig, channels: Mapping[str, Scalars], is_good: Mask
) -> CalibrationEstimate | None:
    """Estimate clock offset, hard and soft iron, misalignment and currents together, against a map of the place."""
    switches = switches_of(config, sensor_log, channels)
    largest = config.time_offset.largest if "time_offset" in switches else 0.0
    if sensor_log.times is not None:
        largest = min(largest, 0.1 * float(np.ptp(sensor_log.times)))
    rows = np.flatnonzero(is_good & sensor_log.covered(0.0, largest))
    if not switches or len(rows) < FEWEST_READINGS:
        return None
    rows = rows[:: -(-len(rows) // config.n_samples)]
    part, values = sensor_log.subset(rows), {name: column[rows] for name, column in channels.items()}
    sizes = {name: size for name, size in EXPECTED_SD.items() if name in switches}
    start = _rough_model(part, largest, sizes)
    estimator = _Estimator(part, values, sizes, coarse_settings(part.positions), largest)
    tell("calibrating against a coarse map of the place")
    # A coarse map takes most of the way, so that the settings of a fine one are chosen once.
    start, _ = estimator.refined(start, set(switches))
    estimator.choose_settings(start)
    model, system = estimator.refined(start, set(switches))
    full = system.solve(switches)
    active, chosen, beyond = set(switches), full, None
    while dropped := _least_shown(chosen, active, switches, config.significance):
        active.discard(dropped)
        chosen = system.solve(active)
    if active and len(active) < len(switches):
        model, system = estimator.refined(model_of(chosen.estimate, values), active)
        chosen = system.solve(active)
    if "time_offset" in active and abs(chosen.estimate["time_offset"][0]) > largest:
        # Where no pose may be any more, there is no offset.
        beyond, active = float(chosen.estimate["time_offset"][0]), active - {"time_offset"}
        model, system = estimator.refined(replace(model, time_offset=0.0), active)
        chosen = system.solve(active)
    calibration = CalibrationEstimate(
        model_of(chosen.estimate, values),
        full,
        chosen,
        {name: _rms(system.solve(active - {name}).residual) for name in active},
        estimator.watched(model, active) if config.currents.mode == "flag" else {},
        (_rms(estimator.as_read()), _rms(chosen.residual)),
        estimator.hyperparameters,
        beyond=beyond,
    )
    return _held_to_account(calibration, part, values)


def _rough_model(part: SensorLog, largest: float, sizes: Mapping[str, float]) -> SensorCorrection:
    """Choose where the estimate begins."""
    tell("looking for the offset between the clocks")
    offset, rough = search_time_offset(part, largest, sizes)
    return replace(model_of(rough.estimate, {}), time_offset=offset)


def _rms(residual: Vectors) -> float:
    return float(np.sqrt((residual**2).mean()))


def _held_to_account(
    calibration: CalibrationEstimate, part: SensorLog, channels: Mapping[str, Scalars]
) -> CalibrationEstimate:
    """The calibration with a map's errors on held-out stretches; withdrawn if they grow or no sensor is like that."""
    errors, spreads = [], []
    for model in (SensorCorrection(), calibration.model):
        positions, orientations = part.at(model.time_offset)
        readings = model.corrected(part.readings, channels)
        errors.append(held_out_error(positions, orientations.apply(readings), calibration.hyperparameters))
        # In the sensor's frame no constant counts: what is left is the field, in which the sensor turned and moved.
        spreads.append(float(np.sqrt(readings.var(axis=0).sum())))
    why = why_no_sensor(calibration.model)
    # Errors count relative to what varies: without a field there would be none.
    if not why and errors[1] * spreads[0] > errors[0] * spreads[1]:
        why = "a map predicts held-out stretches worse with it"
    return replace(calibration.withdrawn(why), held_out=(errors[0], errors[1]))


def switches_of(
    config: PreparationConfig, sensor_log: SensorLog, channels: Mapping[str, Scalars]
) -> dict[str, Switch]:
    """Unknowns that are to be estimated, and whether they must be shown."""
    switches: dict[str, Switch] = {name: getattr(config.calibration, name) for name in EXPECTED_SD}
    if sensor_log.times is not None:
        switches["time_offset"] = config.time_offset.mode
    if config.currents.mode == "remove":
        switches |= {CHANNEL + name: "auto" for name, values in channels.items() if np.ptp(values) > 0}
    switches |= {CHANNEL + name: "auto" for name in channels if name.startswith(PIECE)}
    return {name: switch for name, switch in switches.items() if switch != "off"}


def _least_shown(
    solution: Solution, active: set[str], switches: Mapping[str, Switch], significance: float
) -> str | None:
    """The least significant block of 'auto'; None if all are significant."""
    doubts = {name: solution.p_value[name] for name in active if switches[name] == "auto"}
    worst = max(doubts, key=lambda name: (doubts[name], name), default=None)
    return worst if worst is not None and doubts[worst] > significance else None


class _Estimator:
    """Repeated linearisation against a map of given settings."""

    def __init__(
        self, part: SensorLog, channels: Mapping[str, Scalars], sizes: Mapping[str, float], settings: Hyperparameters,
        largest: float,
    ) -> None:  # fmt: skip
        self.part, self.channels, self.sizes, self.hyperparameters = part, channels, sizes, settings
        self.largest = largest  # s: for offsets up to this all readings have poses
        self.weights = np.ones(len(part))

    def refined(self, model: SensorCorrection, active: set[str]) -> tuple[SensorCorrection, System]:
        """Model at which linearising again changes nothing, and the last linear system."""
        model = self._within(model)
        for step in range(MOST_STEPS):
            before = model.time_offset
            system = self._linearised(model, active)
            solution = system.solve(active)
            model = self._within(model_of(solution.estimate, self.channels))
            self.weights = student_weights((solution.free**2).sum(axis=1) / solution.noise_sd**2, 3)
            sd = solution.sd["time_offset"][0] if "time_offset" in active else np.inf
            if step > 0 and abs(model.time_offset - before) < CONVERGED * sd:
                break
        return model, system

    def _within(self, model: SensorCorrection) -> SensorCorrection:
        """The model with an offset of the clocks for which all readings have poses."""
        return replace(model, time_offset=float(np.clip(model.time_offset, -self.largest, self.largest)))

    def choose_settings(self, model: SensorCorrection) -> None:
        """Settings of a map of the field as corrected so far, which forgets what a coarser one disagreed with."""
        tell("choosing the settings of a fine map")
        positions, orientations = self.part.at(model.time_offset)
        field = orientations.apply(model.corrected(self.part.readings, self.channels))
        h = affordable(positions, choose_spline_hyperparameters(positions, field))
        self.hyperparameters, self.weights = h, np.ones(len(field))
        tell("calibrating against a fine map of the place")

    def watched(self, model: SensorCorrection, active: set[str]) -> dict[str, Solution]:
        """Add one channel at a time to what was kept, so that channels change no other estimate."""
        names = [CHANNEL + name for name in self.channels if not name.startswith(PIECE)]
        if not names:
            return {}
        system = self._linearised(model, active | set(names))
        return {name: system.solve(active | {name}) for name in names if name in system.names}

    def as_read(self) -> Vectors:
        """Inconsistency of the field as it stands in the log: (n, 3), T."""
        positions, orientations = self.part.at(0.0)
        project = MapConsistency(positions, self.hyperparameters, np.ones(len(self.part))).project
        return np.asarray(project(orientations.apply(self.part.readings)[None])[1][0])

    def _linearised(self, model: SensorCorrection, active: set[str]) -> System:
        """Columns of all active unknowns about a model."""
        positions, orientations = self.part.at(model.time_offset)
        R = orientations.as_matrix()
        consistency = MapConsistency(positions, self.hyperparameters, self.weights)
        y = np.einsum("nij,nj->ni", R, self.part.readings)
        blocks = sensor_blocks(R, self.part.readings, {k: v for k, v in self.sizes.items() if k in active})
        used = {name: values for name, values in self.channels.items() if CHANNEL + name in active}
        blocks |= channel_blocks(R, used, CHANNEL_SD)
        if "time_offset" in active:
            velocity, spin = self.part.motion(model.time_offset)
            field = np.einsum("nij,nj->ni", R, model.corrected(self.part.readings, self.channels))
            drift = np.cross(spin, field) - np.einsum("nij,nj->ni", consistency.gradient(field), velocity)
            blocks["time_offset"] = ParameterBlock(drift[None], TIME_OFFSET_SD)
            y = y - model.time_offset * drift
        return System.of(y, blocks, consistency.project)
