# SPDX-License-Identifier: BSD-3-Clause
"""The offset between two clocks from translation alone, and what is estimated at all."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.preparation.calibrate_on_map import calibrate
from magmatch.preparation.calibration_steps import calibration_steps
from magmatch.preparation.config import PreparationConfig, TimeOffsetConfig
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.time_offset import search_time_offset

OFF = dict.fromkeys(("hard_iron", "soft_iron", "misalignment"), "off")
CLOCK_ALONE = PreparationConfig.model_validate({"calibration": OFF})
OFFSET = 0.061  # between the steps of the first search


def field_at(x):
    """Of a buried line of sources: without divergence and curl."""
    u, w = 1.5 * x[:, 0] + 0.5 * x[:, 1], 1.5811388300841898 * (x[:, 2] - 1.0)
    size = 8e-6 * np.exp(w)
    gradient = np.stack([1.5 * np.cos(u), 0.5 * np.cos(u), 1.5811388300841898 * np.sin(u)], axis=1)
    return np.array([18e-6, 2e-6, -44e-6]) + size[:, None] * gradient


def log_of(offset=OFFSET):
    """To and fro over one floor at speeds that change, never turning."""
    rng = np.random.default_rng(1)
    t = np.arange(0, 40, 0.1)

    def poses(t):
        x = np.stack([1.6 * np.sin(0.9 * t), 1.6 * np.sin(0.53 * t + 1), 0.1 * np.sin(1.7 * t)], axis=1)
        return x, Rotation.from_rotvec(0 * x)

    there, attitudes = poses(t + offset)
    readings = field_at(there) + 0.1e-6 * rng.standard_normal((len(t), 3))
    wide = np.arange(-1, 42, 0.05)
    return SensorLog.of(Survey(poses(t)[0], readings, t, attitudes), Trajectory(wide, *poses(wide)))


def test_the_clocks_offset_is_found_from_translation_alone():
    log = log_of()
    found = calibrate(log, CLOCK_ALONE, {}, np.ones(len(log), dtype=bool))
    assert found.model.time_offset == pytest.approx(OFFSET, abs=3e-3)
    assert not found.refused
    assert found.held_out[1] < 0.8 * found.held_out[0]
    assert found.inconsistency[1] < 0.8 * found.inconsistency[0]
    assert found.without["time_offset"] > 1.2 * found.inconsistency[1]


def test_too_few_readings_or_nothing_to_estimate_give_nothing():
    log = log_of()
    off = PreparationConfig.model_validate({"calibration": OFF, "time_offset": {"mode": "off"}})
    assert calibrate(log, off, {}, np.ones(len(log), dtype=bool)) is None
    assert calibrate(log, CLOCK_ALONE, {}, np.arange(len(log)) < 99) is None


def test_the_search_for_an_offset_ends_within_a_step_of_it_and_at_none_where_there_is_none():
    for offset, largest, expected in ((OFFSET, 0.3, OFFSET), (0.0, 0.3, 0.0), (OFFSET, 0.0, 0.0)):
        found, solution = search_time_offset(log_of(offset), largest, {"hard_iron": 1e-5})
        assert found == pytest.approx(expected, abs=0.0126)
        assert set(solution.estimate) == {"hard_iron"}
    # At the right offset the map explains what it cannot at another.
    assert search_time_offset(log_of(0.0), 0.0, {})[1].noise_sd < solution.noise_sd


def test_an_offset_beyond_those_that_were_searched_is_none_and_said_so():
    log = log_of(offset=0.35)
    narrow = CLOCK_ALONE.model_copy(update={"time_offset": TimeOffsetConfig(largest=0.1)})
    found = calibrate(log, narrow, {}, np.ones(len(log), dtype=bool))
    assert found.model.time_offset == 0
    assert abs(found.beyond) > 0.1
    (step,) = [s for s in calibration_steps(log, found, narrow, {}, "") if s.step == "time offset"]
    assert step.outcome == "unknown"
    assert "more than was searched" in step.words
