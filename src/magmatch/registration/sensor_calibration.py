# SPDX-License-Identifier: BSD-3-Clause
"""Calibration of surveys whose readings show hard iron, as by `magmatch prepare`: clock and soft iron, too."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.errors import MagmatchError
from magmatch.field.map import FieldMap
from magmatch.preparation.config import DisturbancesConfig, PreparationConfig
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.preparation.sensor_trace import MIN_EVIDENCE, offset_evidence
from magmatch.progress import tell
from magmatch.registration.index.atlas import Atlas
from magmatch.registration.maps import map_of
from magmatch.registration.result import Calibration, Sensor
from magmatch.registration.steps import Base, Outcome, Target
from magmatch.threads import side_by_side

P = ParamSpec("P")
T = TypeVar("T")
Answered = TypeVar("Answered", bound=tuple[Any, ...])

log = logging.getLogger(__name__)

# Clock and sensor alone; nothing is left out.
SETTINGS = PreparationConfig(
    disturbances=DisturbancesConfig(spikes="off", drop_outs="off", saturation="off", moving_metal="off")
)

# Of soft iron and turns: rounding.
SMALLEST = float(np.sqrt(np.finfo(float).eps))


@dataclass(frozen=True, eq=False, slots=True)
class Calibrated:
    """A survey with its sensor's errors corrected."""

    survey: Survey
    sensor: SensorCorrection  # the correction
    evidence: float  # nats: of its map's samples, for a field that turns with the sensor and that the map left

    def as_dict(self) -> Calibration:
        """For JSON: ``b_true = matrix b_read - shift`` (T, sensor frame), and the clock's offset (s)."""
        matrix, shift = self.sensor.matrix.tolist(), self.sensor.shift.tolist()
        return Calibration(time_offset=self.sensor.time_offset, matrix=matrix, shift=shift)


def without_sensor_errors(survey: Survey, sensor: Mapping[str, Any] | None, side: str) -> Survey:
    """Apply a result's correction of the sensor of one ``side``, base or target, to its survey.

    The same object if there is no correction, or no orientations to apply it with.
    """
    model = _models(sensor).get(side)
    if model is None or survey.orientations is None:
        return survey
    from magmatch.preparation.sensor_estimate import apply_model
    from magmatch.preparation.sensor_log import SensorLog

    return apply_model(survey, SensorLog.of(survey, None), model, {}, is_changed=False)[0]


def in_words(sensor: Mapping[str, Any] | None) -> dict[str, str]:
    """A result's correction of each survey's sensor, in words by side; empty if there was none."""
    return {side: _words(model) for side, model in _models(sensor).items()}


def _models(sensor: Mapping[str, Any] | None) -> dict[str, SensorCorrection]:
    stated = (sensor or {}).get("calibrated") or {}
    return {
        side: replace(SensorCorrection.from_dict(one), time_offset=one["time_offset"]) for side, one in stated.items()
    }


def _words(model: SensorCorrection) -> str:
    hard_iron, stretch = float(np.linalg.norm(model.hard_iron)), np.linalg.svd(model.soft_iron)[1]
    turn = float(np.linalg.norm(model.misalignment))
    parts = {
        f"clock {1e3 * model.time_offset:+.0f} ms": model.time_offset != 0,
        f"hard iron {field_text(hard_iron)}": hard_iron > 0,
        f"soft iron {100 * (stretch.max() - stretch.min()) / 2:.1f} %": np.ptp(stretch) > SMALLEST,
        f"mounted {np.degrees(turn):.1f} deg askew": turn > SMALLEST,
    }
    return ", ".join(words for words, is_told in parts.items() if is_told) or "nothing"


def calibrate_sensors(
    base: Base, found: Outcome, samples: Survey
) -> tuple[tuple[Base, Target, Survey], Mapping[str, Calibrated]] | None:
    """Calibrate base and target if their readings turn with their sensor; None if neither's do.

    ``found`` is the outcome of the registration as given, ``samples`` are all of the target's. Gives what the second
    registration takes, base, target and all its samples, and the sides that were calibrated.
    """
    prepared, target, _ = found
    asked = dict[str, tuple[FieldMap, Survey]]()
    # One of many maps was saved by somebody who could calibrate it; its rivals stay as they are.
    if not isinstance(base, Atlas):
        base_map = map_of(prepared)
        asked["base"] = base_map, base if isinstance(base, Survey) else base_map.survey
    # A walk that was not mapped is too short for this test.
    if isinstance(target, FieldMap):
        asked["target"] = target, samples
    calibrated = side_by_side(lambda side: calibrate(*asked[side]), asked)
    sides = {side: one for side, one in zip(asked, calibrated, strict=True) if one is not None}
    if not sides:
        return None
    # Its prepared map is used again.
    again: Base = base if isinstance(base, Atlas) else prepared
    if "base" in sides:
        again = sides["base"].survey
    if "target" in sides:
        samples = target = sides["target"].survey
    tell("registering once more, calibrated")
    return (again, target, samples), sides


def better_supported(as_given: Answered, calibrated: Answered | None, sides: Mapping[str, Calibrated]) -> Answered:
    """Choose the likelier of two models, sensors as they are stated and sensors as they were calibrated.

    Against the first counts what its maps' samples say for a field that still turns with the sensor: such a field is
    not that of the place, however well it agrees. The second is None if calibration failed.
    """
    if calibrated is None:
        return as_given
    second = calibrated[-1]
    first_evidence, second_evidence = (answer[-1].evidence.get("effective") for answer in (as_given, calibrated))
    if second_evidence is None:
        return as_given
    if first_evidence is not None and first_evidence - sum(s.evidence for s in sides.values()) >= second_evidence:
        return as_given
    stated = {name: side.as_dict() for name, side in sides.items()}
    answer = replace(second, sensor=(second.sensor or Sensor()) | Sensor(calibrated=stated))
    return cast("Answered", (*calibrated[:-1], answer))


def calibrate(field_map: FieldMap, survey: Survey) -> Calibrated | None:
    """Calibrate a survey, with all its samples, if its readings turn with its sensor.

    The map is of the survey as it is; it leaves out samples that contradict the rest, as uncalibrated readings do.
    None if no error is significant; also for a map of several surveys, whose sensors differ, and for one of a
    declared box.
    """
    if field_map.parts or field_map.config.domain is not None:
        return None
    measured, h = field_map.measured, field_map.hyperparameters
    evidence = offset_evidence(measured, h)
    if evidence < MIN_EVIDENCE:
        return None
    if field_map.biases is not None:
        # The map solved hard iron. A clock's offset and soft iron leave a field that still turns with the sensor.
        evidence = max(offset_evidence(field_map.survey, h), 0.0)
    # Imported only when needed: the import is slow.
    from magmatch.preparation.prepare import prepare

    log.info("%s: its readings turn with the sensor, which is calibrated", survey.name)
    done = attempted(prepare, measured if survey is field_map.survey else survey, SETTINGS)
    return None if done is None or done[1].sensor.is_identity else Calibrated(done[0], done[1].sensor, evidence)


def attempted(task: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
    """Result of a step towards the second answer; None if it fails: then the first answer is kept."""
    try:
        return task(*args, **kwargs)
    except (MagmatchError, np.linalg.LinAlgError) as error:
        log.info("not calibrated: %s", error)
        return None
