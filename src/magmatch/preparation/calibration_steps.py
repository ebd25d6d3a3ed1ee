# SPDX-License-Identifier: BSD-3-Clause
"""The calibration in words and figures: what was corrected, not significant, or not determined by the data."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from magmatch.data.units import TESLA_PER_UNIT
from magmatch.preparation.calibrate_on_map import CalibrationEstimate
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.preparation_report import Outcome, StepReport
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import CHANNEL, EXPECTED_SD, SensorCorrection
from magmatch.typing import Scalars

AXES = ("x", "y", "z")
SOFT_IRON_PARTS = ("(xx-yy)/2", "zz", "xy", "xz", "yz")
NEGLIGIBLE = 0.01  # uT, %, deg


def calibration_steps(
    sensor_log: SensorLog | None, calibration: CalibrationEstimate | None, config: PreparationConfig,
    channels: Mapping[str, Scalars], why_not: str,
) -> list[StepReport]:  # fmt: skip
    """Reports of the time offset, hard iron, soft iron, misalignment and each channel."""
    modes = {"time_offset": config.time_offset.mode} | {n: getattr(config.calibration, n) for n in EXPECTED_SD}
    steps = []
    for name, mode in modes.items():
        label = name.replace("_", " ")
        if mode == "off":
            steps.append(StepReport(label, "off", ""))
        elif calibration is None or name not in calibration.full.estimate:
            steps.append(StepReport(label, "unknown", _why_not(name, sensor_log, why_not)))
        else:
            steps.append(_error_report(name, label, calibration))
    if config.currents.mode != "off" and calibration is not None:
        reported = {CHANNEL + name: values for name, values in channels.items()}
        reported = {k: v for k, v in reported.items() if k in calibration.watched or k in calibration.full.estimate}
        steps += [_channel_report(name, calibration, values, config) for name, values in reported.items()]
    if calibration is not None:
        steps.append(_held_out_step(calibration))
    return steps


def known_sensor_step(sensor: SensorCorrection | None) -> StepReport:
    """Report of a correction that was known before."""
    if sensor is None:
        return StepReport("known sensor", "off", "")
    hard = ", ".join(f"{axis} {1e6 * value:+.3g}" for axis, value in zip(AXES, sensor.hard_iron, strict=True))
    soft = 100 * float(np.abs(sensor.soft_iron - np.eye(3)).max())
    words = f"hard iron {hard} uT, soft iron up to {soft:.2g} %, taken off first"
    return StepReport("known sensor", "applied", words)


def estimate_text(name: str, estimate: np.ndarray, sd: np.ndarray, is_open: np.ndarray) -> str:
    """Estimates with their standard deviations, and which the data leave open."""
    if name == "time_offset":
        if is_open[0]:
            return "not determined by the motion; rotate the sensor more, or walk back and forth"
        return f"{1e3 * estimate[0]:+.2f} ms (sd {1e3 * sd[0]:.2f}) to be added to the magnetometer's times"
    parts: tuple[str, ...] = SOFT_IRON_PARTS if name == "soft_iron" else AXES
    per_unit, unit = {"soft_iron": (1e2, "%"), "misalignment": (180 / np.pi, "deg")}.get(name, (1e6, "uT"))
    if name.startswith(CHANNEL):
        unit = "uT per unit of the channel"
    rows = list(zip(parts, per_unit * estimate, is_open, strict=True))
    # Unknowns may be open one by one although a combination of them is known: that shows as a value.
    known = [f"{part} {value:+.3g}" for part, value, hidden in rows if not hidden or abs(value) > NEGLIGIBLE]
    hidden = ", ".join(part for part, _, flag in rows if flag)
    prefix = "correction " if name == "soft_iron" else ""
    sure = f" (sd up to {per_unit * sd[~is_open].max():.2g})" if not is_open.all() else ""
    said = [f"{prefix}{', '.join(known)} {unit}{sure}"] if known else []
    if hidden:
        said.append(f"{hidden} not separable from the place's own field: the sensor turned too little")
    return "; ".join(said)


def _held_out_step(calibration: CalibrationEstimate) -> StepReport:
    """All corrections together, judged by stretches that were left out."""
    words, is_applied = "median error of a map on held-out stretches", not calibration.model.is_identity
    if calibration.refused:
        words, is_applied = f"withdrawn, none was applied: {calibration.refused}", False
    return _in_microtesla("all corrections", "applied" if is_applied else "unchanged", words, *calibration.held_out)


def _in_microtesla(
    name: str, outcome: Outcome, words: str, before: float, after: float, figures: Mapping[str, Any] | None = None
) -> StepReport:
    """Report a step by what it left of an error, T."""
    before, after = (value / TESLA_PER_UNIT["uT"] for value in (before, after))
    return StepReport(name, outcome, words, before, after, "uT", figures or {})


def _why_not(name: str, sensor_log: SensorLog | None, why_not: str) -> str:
    """Say why nothing could be estimated."""
    if sensor_log is None:
        return "needs orientations (columns qx, qy, qz, qw, or a trajectory): sensor errors turn with the sensor"
    if name == "time_offset" and sensor_log.times is None:
        return "needs times"
    return why_not


def _error_report(name: str, label: str, calibration: CalibrationEstimate) -> StepReport:
    """Report of one error of clock or sensor that was estimated."""
    is_kept = name in calibration.chosen.estimate and not calibration.refused
    solution = calibration.chosen if is_kept else calibration.full
    estimate, sd, is_open = solution.estimate[name], solution.sd[name], solution.is_open[name]
    outcome: Outcome = "applied" if is_kept else "unknown" if is_open.all() else "unchanged"
    words = estimate_text(name, estimate, sd, is_open)
    if name == "time_offset" and calibration.beyond is not None:
        outcome = "unknown"
        words = f"{1e3 * calibration.beyond:+.0f} ms would be more than was searched (time_offset.largest): none"
    elif outcome == "unchanged":
        words += "; withdrawn with all corrections" if calibration.refused else "; not shown"
    figures = {
        "estimate": estimate.tolist(), "sd": sd.tolist(), "is_open": is_open.tolist(),
        "p_value": calibration.full.p_value[name], "inconsistency_as_read": calibration.inconsistency[0],
    }  # fmt: skip
    if name == "hard_iron" and is_kept:
        figures["hard_iron"] = calibration.model.hard_iron.tolist()
    if name in {"soft_iron", "misalignment"} and is_kept:
        figures["soft_iron"] = calibration.model.soft_iron.tolist()
    after = calibration.inconsistency[1]
    before = calibration.without.get(name, after) if is_kept else after
    return _in_microtesla(label, outcome, words, before, after, figures)


def _channel_report(
    name: str, calibration: CalibrationEstimate, values: Scalars, config: PreparationConfig
) -> StepReport:
    """Report of one channel: what it adds to the readings per unit, and whether that was taken off."""
    is_removed = config.currents.mode == "remove"
    solution = calibration.watched.get(name, calibration.full)
    if is_removed and name in calibration.chosen.estimate:
        solution = calibration.chosen
    is_open, spread = solution.is_open[name], float(values.std())
    estimate, sd = solution.estimate[name] / spread, solution.sd[name] / spread
    is_shown = solution.p_value[name] < config.significance
    words = estimate_text(name, estimate, sd, is_open) + ("" if is_shown else "; not shown")
    outcome: Outcome = ("applied" if is_removed else "flagged") if is_shown else "unchanged"
    after = calibration.inconsistency[1]
    before = calibration.without.get(name, after) if is_removed else after
    if is_shown and not is_removed:
        words += "; kept (currents.mode: remove takes it off)"
    figures = {"estimate": estimate.tolist(), "sd": sd.tolist(), "p_value": solution.p_value[name]}
    return _in_microtesla(name, outcome, words, before, after, figures)
