# SPDX-License-Identifier: BSD-3-Clause
"""The steps that a log goes through; only those switched on here are taken."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from magmatch.settings import Settings


def _as_word(value: Any) -> Any:
    """YAML reads the words on and off without quotes as true and false."""
    return "on" if value is True else "off" if value is False else value


UNQUOTED = BeforeValidator(_as_word)
# off: not estimated. auto: estimated, and applied only if significant. on: applied whenever the data determine it.
Switch = Annotated[Literal["off", "auto", "on"], UNQUOTED]
# off: not checked. flag: reported. remove: also left out of the survey.
Flagging = Annotated[Literal["off", "flag", "remove"], UNQUOTED]


class TimeOffsetConfig(Settings):
    """Clock of the magnetometer against that of the poses."""

    # off: not estimated. auto: applied where the data show it. on: applied whenever they determine it.
    mode: Switch = "auto"
    # Largest offset searched for, s; loggers on one machine differ by tens of ms, buffered ones by some hundred.
    largest: float = Field(default=1.0, gt=0, le=60)


class CalibrationConfig(Settings):
    """Errors of the magnetometer itself."""

    # A constant vector in the sensor's frame: magnetised parts that turn with the sensor, and electronics.
    hard_iron: Switch = "auto"
    # A symmetric matrix: soft iron, unequal gains and axes that are not square.
    soft_iron: Switch = "auto"
    # A small turn of the sensor against the frame of the poses (0.6 rad at most, where it is still linear enough).
    misalignment: Switch = "auto"


class CurrentsConfig(Settings):
    """Disturbance that follows another channel of the log, such as a motor's current."""

    # Reported only, by default: a channel that happens to follow the place would take the map's part with it.
    mode: Flagging = "flag"


class DisturbancesConfig(Settings):
    """Samples that do not measure the ambient field."""

    # Readings unlike their neighbours. By default all four are only flagged: a sharp peak beside steel looks the same
    # as a spike, and registration bears a few bad samples better than missing good ones.
    spikes: Flagging = "flag"
    # Readings repeated although the sensor moved on, and gaps in time.
    drop_outs: Flagging = "flag"
    # Readings at the end of the sensor's range.
    saturation: Flagging = "flag"
    # Seconds in which the field contradicts what other passes found at the same places.
    moving_metal: Flagging = "flag"
    # A spike differs from its neighbours in time and from the map by this many standard deviations; ten keeps the
    # steel beside a path.
    spike_threshold: float = Field(default=10.0, gt=0)


class ResamplingConfig(Settings):
    """One sample per distance walked."""

    # Distance, m; None keeps every sample. Standing still weighs as much as walking, unless resampled.
    step: float | None = Field(default=None, gt=0)
    # What stands for the readings of a step.
    average: Literal["mean", "median"] = "median"


class PreparationConfig(Settings):
    """Settings of `magmatch.prepare`."""

    # m: of the samples of each step of the way only the first is used and kept; None takes all. Motion capture and
    # fast sensors give thousands to a metre, which tell no more and cost time.
    thin: float | None = Field(default=None, gt=0)
    # Jumps of the sensor's own calibration, as phones have them. off: not looked for. auto: the log is cut there.
    recalibration: Annotated[Literal["off", "auto"], UNQUOTED] = "auto"
    time_offset: TimeOffsetConfig = TimeOffsetConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    currents: CurrentsConfig = CurrentsConfig()
    disturbances: DisturbancesConfig = DisturbancesConfig()
    resampling: ResamplingConfig = ResamplingConfig()
    # Samples that estimates are made from, at equal distances through the log; more change nothing but the time.
    n_samples: int = Field(default=4000, ge=200)
    # What 'auto' needs: the chance of an error-free log showing as much.
    significance: float = Field(default=1e-4, gt=0, lt=1)
