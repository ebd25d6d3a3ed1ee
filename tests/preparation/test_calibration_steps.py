# SPDX-License-Identifier: BSD-3-Clause
"""Reports of a calibration state its numbers, in their units, and whether they were applied."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.preparation.calibrate_on_map import CalibrationEstimate
from magmatch.preparation.calibration_steps import calibration_steps, known_sensor_step
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.least_squares import Solution
from magmatch.preparation.sensor_log import SensorLog
from magmatch.preparation.sensor_model import CHANNEL, SensorCorrection, model_of

SURVEY = Survey(np.arange(9.0).reshape(3, 3), np.full((3, 3), 2e-5), orientations=Rotation.identity(3))
LOG = SensorLog.of(SURVEY, None)
ESTIMATE = {
    "time_offset": np.array([-0.04]), "hard_iron": np.array([12e-6, -3e-6, 0.0]),
    "soft_iron": np.array([0.02, -0.01, 0.005, 0.0, 0.03]), "misalignment": np.radians([1.0, 2.0, -3.0]),
    CHANNEL + "motor": np.array([4e-6, 0.0, -2e-6]),
}  # fmt: skip
SD = {
    name: np.full(len(values), 1e-3 if name in {"time_offset", "soft_iron"} else 1e-7)
    for name, values in ESTIMATE.items()
}
CURRENT = np.array([1.0, 5.0, 3.0])  # its standard deviation is sqrt(8 / 3)


def solution(names, p_value=1e-6, open_=()):
    is_open = {name: np.array([(name, k) in open_ for k in range(len(ESTIMATE[name]))]) for name in names}
    zeros = np.zeros((3, 3))
    return Solution(
        {n: ESTIMATE[n] for n in names},
        {n: SD[n] for n in names},
        dict.fromkeys(names, p_value),
        is_open,
        zeros,
        zeros,
        1e-7,
    )


def reports(chosen, full=None, *, is_refused=False, currents="flag", p_value=1e-6, watched=None, **settings):
    full = full or solution(list(ESTIMATE), p_value)
    model = SensorCorrection() if is_refused or not chosen.estimate else model_of(chosen.estimate, {"motor": CURRENT})
    calibration = CalibrationEstimate(
        model, full, chosen, dict.fromkeys(chosen.estimate, 5e-06), watched or {}, (9e-6, 2e-6),
        Hyperparameters(0.4, 1e-5, 4e-7, 0.2), "it is worse" if is_refused else "", None, (3e-6, 1e-6),
    )  # fmt: skip
    config = PreparationConfig.model_validate({"currents": {"mode": currents}, **settings})
    steps = calibration_steps(LOG, calibration, config, {"motor": CURRENT}, "")
    return {step.step: step for step in steps}


def test_what_is_applied_is_stated_in_its_unit_with_what_it_gained():
    steps = reports(solution([name for name in ESTIMATE if not name.startswith(CHANNEL)]))
    for name, words in {
        "time offset": "-40.00 ms (sd 1.00) to be added to the magnetometer's times",
        "hard iron": "x +12, y -3, z +0 uT (sd up to 0.1)",
        "soft iron": "correction (xx-yy)/2 +2, zz -1, xy +0.5, xz +0, yz +3 % (sd up to 0.1)",
        "misalignment": "x +1, y +2, z -3 deg (sd up to 5.7e-06)",
    }.items():
        assert steps[name].words == words
        assert steps[name].outcome == "applied"
        # Microtesla: what would remain without it, and what remains.
        assert (steps[name].before, steps[name].after, steps[name].unit) == (
            pytest.approx(5.0),
            pytest.approx(2.0),
            "uT",
        )
    own = {name: values for name, values in ESTIMATE.items() if not name.startswith(CHANNEL)}
    model = model_of(own, {})
    assert steps["hard iron"].figures["hard_iron"] == pytest.approx(model.hard_iron.tolist())
    np.testing.assert_allclose(steps["soft iron"].figures["soft_iron"], model.soft_iron)
    assert steps["all corrections"].outcome == "applied"
    assert (steps["all corrections"].before, steps["all corrections"].after) == (
        pytest.approx(3.0),
        pytest.approx(1.0),
    )


def test_what_was_dropped_is_not_shown_and_gained_nothing():
    step = reports(solution(["time_offset"]))["hard iron"]
    assert step.outcome == "unchanged"
    assert step.words.endswith("; not shown")
    assert step.before == step.after == pytest.approx(2.0)
    assert "hard_iron" not in step.figures


def test_corrections_that_predict_worse_are_withdrawn_in_words_too():
    steps = reports(solution(["hard_iron"]), is_refused=True)
    assert steps["hard iron"].outcome == "unchanged"
    assert steps["hard iron"].words.endswith("; withdrawn with all corrections")
    assert steps["all corrections"].outcome == "unchanged"
    assert steps["all corrections"].words == "withdrawn, none was applied: it is worse"


def test_unknowns_that_the_data_leave_open_are_named():
    open_ = [("hard_iron", 2)]
    step = reports(solution(["hard_iron"], open_=open_))["hard iron"]
    assert step.words.startswith("x +12, y -3 uT (sd up to 0.1); z not separable")
    every = [("hard_iron", k) for k in range(3)] + [("time_offset", 0)]
    steps = reports(solution([]), solution(list(ESTIMATE), open_=every))
    assert steps["hard iron"].outcome == steps["time offset"].outcome == "unknown"
    assert "not determined by the motion" in steps["time offset"].words


@pytest.mark.parametrize(("mode", "outcome"), [("flag", "flagged"), ("remove", "applied")])
def test_a_channel_is_stated_per_unit_of_its_own(mode, outcome):
    name = CHANNEL + "motor"
    step = reports(solution([name]), currents=mode, watched={} if mode == "remove" else {name: solution([name])})[
        name
    ]
    assert step.outcome == outcome
    per_unit = ESTIMATE[name] / np.sqrt(8 / 3)
    assert step.figures["estimate"] == pytest.approx(per_unit.tolist())
    assert step.figures["sd"] == pytest.approx((SD[name] / np.sqrt(8 / 3)).tolist())
    assert f"x {1e6 * per_unit[0]:+.3g}" in step.words
    assert step.words.endswith("takes it off)") == (mode == "flag")
    assert step.before == pytest.approx(5.0 if mode == "remove" else 2.0)


def test_a_channel_that_is_chance_is_not_shown():
    name = CHANNEL + "motor"
    step = reports(solution([]), p_value=0.2, watched={name: solution([name], 0.2)})[name]
    assert step.outcome == "unchanged"
    assert step.words.endswith("; not shown")


def test_a_known_sensor_is_stated_in_microtesla_and_percent():
    model = model_of({"hard_iron": ESTIMATE["hard_iron"], "soft_iron": ESTIMATE["soft_iron"]}, {})
    step = known_sensor_step(model)
    largest = 100 * np.abs(model.soft_iron - np.eye(3)).max()
    x, y, z = 1e6 * model.hard_iron
    assert (
        step.words
        == f"hard iron x {x:+.3g}, y {y:+.3g}, z {z:+.3g} uT, soft iron up to {largest:.2g} %, taken off first"
    )
    assert known_sensor_step(None).outcome == "off"
