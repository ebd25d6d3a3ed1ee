# SPDX-License-Identifier: BSD-3-Clause
"""Magnetometers that differ by a constant along the vertical: another look at a pair, with means made equal.

Hard iron along the vertical is a constant in the field that a level carrier measures, whatever its heading. So no
survey of its own shows it, and two robots may differ by far more than the search allows. Where z is up in both, the
mean vertical field over each survey says by how much, up to how places differ; the refinement estimates the rest.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.estimation.model_prior import HARD_IRON_SD
from magmatch.progress import tell
from magmatch.registration.maps import survey_of
from magmatch.registration.refine.sensors import BIAS_LEVELS
from magmatch.registration.result import Sensor
from magmatch.registration.steps import Base, Outcome

# Registers base, target and all its samples, at so much log prior odds more; None if that fails.
Look = Callable[[Base, Survey, Survey, float], Outcome | None]


def with_vertical_offset(found: Outcome, look: Look) -> Outcome:
    """An accepted outcome of a look that allows for a vertical offset, which its sensor's bias states; or ``found``.

    z is up in base and target.
    """
    base, target, answer = found
    samples = survey_of(target)
    offset = np.array([0.0, 0.0, _mean(samples) - _mean(survey_of(base))])
    # Like sensors differ by less.
    if answer.is_accepted or abs(offset[2]) <= BIAS_LEVELS[0]:
        return found
    tell(f"looking once more, for a vertical offset of {field_text(abs(offset[2]))} between the sensors")
    shifted = replace(samples, field=samples.field - offset)
    again = look(base, shifted, shifted, _log_prior(float(offset[2])))
    if again is None or not again[2].is_accepted:
        return found
    before, sensor = answer.sensor or Sensor(), again[2].sensor or Sensor()
    if "calibrated" in before:  # base and target already are, so this look found nothing of it
        sensor = sensor | Sensor(calibrated=before["calibrated"])
    bias = offset + np.asarray(sensor.get("bias", np.zeros(3)))
    return base, target, replace(again[2], sensor=sensor | Sensor(bias=bias.tolist()))


def _log_prior(offset: float) -> float:
    """Log prior of offsets as near this one (T) as the refinement looks for them: those of two sensors' hard iron."""
    sd = np.sqrt(2) * HARD_IRON_SD
    return float(np.log(BIAS_LEVELS[-1] / sd) - (offset / sd) ** 2 / 2)


def _mean(survey: Survey) -> float:
    """The survey's vertical field, T: its median, since a magnet would pull a mean."""
    return float(np.median(survey.field[:, 2]))
