# SPDX-License-Identifier: BSD-3-Clause
"""Surveys that show their sensor, calibrated as `magmatch prepare` does: some are only found then."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.errors import MagmatchError
from magmatch.field.map import FieldMap
from magmatch.preparation.config import DisturbancesConfig, PreparationConfig
from magmatch.preparation.sensor_trace import SHOWN, offset_evidence
from magmatch.registration.result import RegistrationResult
from magmatch.threads import side_by_side

if TYPE_CHECKING:
    from magmatch.preparation.sensor_model import SensorModel

log = logging.getLogger(__name__)

# Clock and sensor alone; nothing is left out.
SETTINGS = PreparationConfig(
    disturbances=DisturbancesConfig(spikes="off", drop_outs="off", saturation="off", moving_metal="off")
)

# Of soft iron and turns: rounding.
SMALLEST = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Calibrated:
    """A survey without what was found of its sensor.

    Attributes
    ----------
    survey : Survey
    sensor : SensorModel
        What was undone.
    """

    survey: Survey
    sensor: "SensorModel"

    def told(self) -> dict[str, Any]:
        """The sensor's own errors, ready for JSON: s, T, and plain numbers; sensor frame."""
        return {
            "time_offset": self.sensor.time_offset,
            "hard_iron": self.sensor.hard_iron.tolist(),
            "soft_iron": self.sensor.soft_iron.tolist(),
        }


def in_words(sensor: Mapping[str, Any] | None) -> dict[str, str]:
    """What a result says was undone of each survey's sensor, in words by side; empty where nothing was.

    Parameters
    ----------
    sensor : dict or None
        Of a `RegistrationResult`.

    Returns
    -------
    dict of str to str
        ``base``, ``target`` or both.
    """
    told = (sensor or {}).get("calibrated") or {}
    return {side: _words(told[side]) for side in ("base", "target") if side in told}


def _words(errors: Mapping[str, Any]) -> str:
    hard_iron = float(np.linalg.norm(errors.get("hard_iron", 0.0)))
    soft_iron = np.asarray(errors.get("soft_iron", np.eye(3)))
    u, stretch, vt = np.linalg.svd(soft_iron)
    turn = float(Rotation.from_matrix(u @ vt).magnitude())
    parts = {
        f"clock {1e3 * errors.get('time_offset', 0.0):+.0f} ms": errors.get("time_offset", 0.0) != 0,
        f"hard iron {field_text(hard_iron)}": hard_iron > 0,
        f"soft iron {100 * (stretch.max() - stretch.min()) / 2:.1f} %": np.ptp(stretch) > SMALLEST,
        f"mounted {np.degrees(turn):.1f} deg askew": turn > SMALLEST,
    }
    return ", ".join(words for words, is_told in parts.items() if is_told)


def surer(
    as_given: RegistrationResult, calibrated: RegistrationResult, sides: Mapping[str, Calibrated | None]
) -> RegistrationResult:
    """Choose between two answers: an accepted one before a refusal, then by log odds.

    Parameters
    ----------
    as_given, calibrated : RegistrationResult
        Of surveys as they are, and calibrated.
    sides : dict of str to Calibrated or None
        What was calibrated for the second, ``base`` or ``target``.

    Returns
    -------
    RegistrationResult
        The first unless the second is surer; the second says what was undone.
    """
    if _sureness(calibrated) <= _sureness(as_given):
        return as_given
    told = {name: side.told() for name, side in sides.items() if side is not None}
    return replace(calibrated, sensor={**(calibrated.sensor or {}), "calibrated": told})


def _sureness(answer: RegistrationResult) -> tuple[bool, float]:
    log_odds = answer.evidence.get("log_odds")
    return answer.is_accepted, -np.inf if log_odds is None else log_odds


def calibrate_sides(base: FieldMap | None, target: FieldMap | None) -> tuple[Calibrated | None, Calibrated | None]:
    """Calibrate the surveys of two maps where their readings turn with their sensor.

    Parameters
    ----------
    base, target : FieldMap or None
        Maps of the surveys as given; None is passed over.

    Returns
    -------
    base, target : Calibrated or None
        None where nothing is shown beyond doubt.
    """
    first, second = side_by_side(calibrate, (base, target))
    return first, second


def calibrate(field_map: FieldMap | None) -> Calibrated | None:
    """Calibrate the survey of one map where its readings turn with its sensor; None where nothing is shown."""
    # Several surveys in one map have sensors of their own; a declared box was meant for the samples as they are.
    if field_map is None or field_map.parts or field_map.config.domain is not None:
        return None
    survey = field_map.survey
    if offset_evidence(survey, field_map.hyperparameters) < SHOWN:
        return None
    # Imports what half of all registrations take.
    from magmatch.preparation.prepare import prepare

    log.info("%s: its readings turn with the sensor, which is calibrated", survey.name)
    try:
        prepared, report = prepare(survey, SETTINGS)
    except MagmatchError as error:
        log.info("%s: not calibrated: %s", survey.name, error)
        return None
    return None if report.sensor.is_identity else Calibrated(prepared, report.sensor)
