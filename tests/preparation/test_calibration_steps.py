# SPDX-License-Identifier: BSD-3-Clause
"""Reports of a calibration state its numbers, in their units, and whether they were applied."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.preparation.calibrate_on_map import CalibrationEstimate
from magmatch.preparation.calibration_steps import calibration_steps
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.least_squares import Solution
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import SensorCorrection, model_of

LOG = SensorLog.of(Survey(np.arange(9.0).reshape(3, 3), np.full((3, 3), 2e-5), orientations=Rotation.identity(3)))
ESTIMATE = {
    "time_offset": np.array([-0.04]), "hard_iron": np.array([12e-6, -3e-6, 0.0]),
    "soft_iron": np.array([0.02, -0.01, 0.005, 0.0, 0.03]), "misalignment": np.radians([1.0, 2.0, -3.0]),
}  # fmt: skip
WORDS = {
    "time offset": "-40.00 ms (sd 1.00) to be added to the magnetometer's times",
    "hard iron": "x +12, y -3, z +0 uT (sd up to 0.1)",
    "soft iron": "correction (xx-yy)/2 +2, zz -1, xy +0.5, xz +0, yz +3 % (sd up to 0.1)",
    "misalignment": "x +1, y +2, z -3 deg (sd up to 5.7e-06)",
}


def reports(refused=""):
    sd = {n: np.full(len(v), 1e-3 if n in {"time_offset", "soft_iron"} else 1e-7) for n, v in ESTIMATE.items()}
    is_open = {name: np.zeros(len(values), dtype=bool) for name, values in ESTIMATE.items()}
    found = Solution(ESTIMATE, sd, dict.fromkeys(ESTIMATE, 1e-6), is_open, np.zeros((3, 3)), np.zeros((3, 3)), 1e-7)
    calibration = CalibrationEstimate(
        SensorCorrection() if refused else model_of(ESTIMATE, {}), found, found, dict.fromkeys(ESTIMATE, 5e-06), {},
        (9e-6, 2e-6), Hyperparameters(0.4, 1e-5, 4e-7, 0.2), refused, None, (3e-6, 1e-6),
    )  # fmt: skip
    return {step.step: step for step in calibration_steps(LOG, calibration, PreparationConfig(), {}, "")}


def test_what_is_applied_is_stated_in_its_unit_with_what_it_gained():
    steps, model = reports(), model_of(ESTIMATE, {})
    for name, words in WORDS.items():
        assert (steps[name].words, steps[name].outcome, steps[name].unit) == (words, "applied", "uT")
        # Microtesla: what would remain without it, and what remains.
        assert [steps[name].before, steps[name].after] == pytest.approx([5.0, 2.0])
    assert steps["hard iron"].figures["hard_iron"] == pytest.approx(model.hard_iron.tolist())
    np.testing.assert_allclose(steps["soft iron"].figures["soft_iron"], model.soft_iron)
    assert steps["all corrections"].outcome == "applied"
    assert [steps["all corrections"].before, steps["all corrections"].after] == pytest.approx([3.0, 1.0])


def test_corrections_that_predict_worse_are_withdrawn_in_words_too():
    steps = reports("it is worse")
    assert steps["hard iron"].outcome == steps["all corrections"].outcome == "unchanged"
    assert steps["hard iron"].words.endswith("; withdrawn with all corrections")
    assert steps["all corrections"].words == "withdrawn, none was applied: it is worse"
