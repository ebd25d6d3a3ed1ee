# SPDX-License-Identifier: BSD-3-Clause
"""A target as it comes from a raw log is found all the same; what is undone of its sensor is said."""

import json

import numpy as np
import pytest

from magmatch.errors import DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.geometry import transform_error
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.registration.config import PRESETS
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.register import register, register_keeping_maps
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.sensor_calibration import Calibrated, better_supported, in_words, without_sensor_errors
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.corruption import corrupt, draw_corruption
from magmatch.simulation.simulate import simulate

# By points alone: what walks need is not prepared.
POINTS = PRESETS["default"].model_copy(update={"search": "invariants"})
AS_IT_IS = POINTS.model_copy(update={"calibrate": False})


@pytest.fixture(scope="module")
def pair():
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    return simulate("office-hand-held", 41, SimulationConfig(n_samples=1000, room_size=(2.0, 2.0, 0.6)))


@pytest.fixture(scope="module")
def raw(pair):
    rng = np.random.default_rng(41)
    corruption = draw_corruption(rng)
    return corrupt(pair.target, corruption, rng)[0], corruption


@pytest.fixture(scope="module")
def base_map(pair):
    return build_map(pair.base, SPLINE)


@pytest.fixture(scope="module")
def found(base_map, raw):
    return register_keeping_maps(base_map, raw[0], POINTS)


def errors_of(result, pair):
    assert result.is_accepted
    return transform_error(result.T_base_target, pair.T_base_target, pair.target.centroid)


def test_a_raw_target_is_found_once_calibrated(pair, found):
    distance, angle = errors_of(found[2], pair)
    assert distance < 8e-3
    assert np.degrees(angle) < 0.3


@pytest.mark.slow
def test_raw_target_is_found_since_its_map_knows_its_hard_iron_and_better_once_calibrated(pair, base_map, raw, found):
    no_bias = AS_IT_IS.model_copy(update={"field": SPLINE.model_copy(update={"sensor_bias_sd": 0.0})})
    assert not register(base_map, raw[0], no_bias).is_accepted
    distance, angle = errors_of(register(base_map, raw[0], AS_IT_IS), pair)
    assert distance < 20e-3
    # A clock's offset and soft iron are left to the calibration.
    assert errors_of(found[2], pair)[1] < 0.5 * angle


def test_what_was_undone_is_said_and_saved(raw, found, tmp_path):
    result, corruption = found[2], raw[1]
    told = result.sensor["calibrated"]
    assert list(told) == ["target"]
    model = SensorCorrection(np.array(told["target"]["matrix"]), np.array(told["target"]["shift"]))
    np.testing.assert_allclose(model.hard_iron, corruption.hard_iron, atol=1e-6)
    assert told["target"]["time_offset"] == pytest.approx(corruption.clock_offset, abs=4e-3)
    assert "hard iron" in in_words(result.sensor)["target"]
    assert "clock" in in_words(result.sensor)["target"]
    result.save(tmp_path / "result.json")
    again = RegistrationResult.load(tmp_path / "result.json")
    assert again.sensor == result.sensor
    assert in_words(again.sensor) == in_words(result.sensor)


def test_what_was_undone_can_be_undone_again_from_the_result(raw, found):
    """The target that was used comes back, for pictures."""
    _, target, result = found
    assert not np.array_equal(target.survey.field[:100], raw[0].field[:100])
    assert {entry["name"] for entry in result.inputs} == {"office-hand-held base", "office-hand-held target"}
    again = without_sensor_errors(raw[0], result.sensor, "target")
    # The map leaves out what contradicts the rest.
    rows = np.isin(again.times, target.survey.times)
    np.testing.assert_allclose(again.field[rows], target.survey.field, rtol=0, atol=1e-15)
    assert without_sensor_errors(raw[0], result.sensor, "base") is raw[0]
    assert without_sensor_errors(raw[0], None, "target") is raw[0]


@pytest.mark.slow
def test_a_raw_base_is_calibrated_whatever_form_it_comes_in(base_map, raw):
    raw_map = build_map(raw[0], SPLINE)
    forms = raw_map, prepare_index(raw_map)
    results = [register(form, base_map, POINTS) for form in forms]
    for result in results:
        assert result.is_accepted
        assert list(result.sensor["calibrated"]) == ["base"]
    np.testing.assert_array_equal(results[0].T_base_target.as_matrix(), results[1].T_base_target.as_matrix())


@pytest.mark.parametrize(
    "odd",
    [
        True,
        {"sideways": {}},
        {"target": {"time_offset": 0, "shift": [0, 0], "matrix": np.eye(3).tolist()}},
        {"target": {"time_offset": 0, "shift": [0, 0, 0], "matrix": np.zeros((3, 3)).tolist()}},
    ],
)
def test_a_file_with_an_odd_calibration_is_refused(found, tmp_path, odd):
    content = found[2].to_dict()
    content["sensor"]["calibrated"] = odd
    content.pop("checksum", None)
    (tmp_path / "odd.json").write_text(json.dumps(content))
    with pytest.raises(DataFormatError, match="sensor"):
        RegistrationResult.load(tmp_path / "odd.json")


def test_a_clean_pair_is_registered_once(pair, base_map):
    target = build_map(pair.target, SPLINE)
    result, plain = register(base_map, target, POINTS), register(base_map, target, AS_IT_IS)
    np.testing.assert_array_equal(result.T_base_target.as_matrix(), plain.T_base_target.as_matrix())
    assert in_words(result.sensor) == in_words(plain.sensor) == {}
    assert result.seconds["calibrate"] < result.seconds["total"]
    assert "calibrate" not in plain.seconds


@pytest.mark.parametrize(
    ("as_given", "calibrated", "taken"),
    [
        (30.0, 30.0, "calibrated"),
        # The readings alone hold ten nats for a field that turns with the sensor.
        (39.0, 30.0, "calibrated"),
        (41.0, 30.0, "as given"),
        (None, -20.0, "calibrated"),
        (30.0, None, "as given"),
    ],
)
def test_the_likelier_model_of_the_sensors_is_taken(pair, raw, as_given, calibrated, taken):
    def answer(effective):
        return RegistrationResult(Status.INCONSISTENT, "", pair.T_base_target, evidence={"effective": effective})

    first, second = answer(as_given), answer(calibrated)
    sides = {"target": Calibrated(raw[0], SensorCorrection(time_offset=0.01), 10.0)}
    (chosen,) = better_supported((first,), (second,), sides)
    assert (chosen is first) == (taken == "as given")
    assert in_words(chosen.sensor) == ({} if chosen is first else {"target": "clock +10 ms"})
