# SPDX-License-Identifier: BSD-3-Clause
"""Columns of a sensor's errors against finite differences of the correction itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.preparation.sensor_model import (
    CHANNEL,
    SensorCorrection,
    channel_blocks,
    model_of,
    sensor_blocks,
)

RNG = np.random.default_rng(0)
ATTITUDES = Rotation.random(30, random_state=RNG)
R = ATTITUDES.as_matrix()
READINGS = 4e-5 * RNG.standard_normal((30, 3))
SIZES = {"hard_iron": 1e-5, "soft_iron": 0.05, "misalignment": 0.1}
CURRENTS = {"motor": RNG.normal(3.0, 2.0, 30), "still": np.full(30, 7.0)}


def in_place(model, channels=None):
    return ATTITUDES.apply(model.corrected(READINGS, channels))


@pytest.mark.parametrize("name", SIZES)
def test_columns_are_what_a_unit_of_each_unknown_changes(name):
    block = sensor_blocks(R, READINGS, SIZES)[name]
    assert block.sd == SIZES[name]
    for k, column in enumerate(block.columns):
        unit = np.eye(len(block.columns))[k]
        change = in_place(model_of({name: unit}, {})) - in_place(SensorCorrection())
        np.testing.assert_allclose(column, change, atol=1e-15)


def test_a_channels_columns_are_per_standard_deviation_about_its_mean_and_one_that_rests_has_none():
    blocks = channel_blocks(R, CURRENTS, 5e-6)
    assert list(blocks) == [CHANNEL + "motor"]
    estimate = {CHANNEL + "motor": np.array([1e-6, -2e-6, 3e-6])}
    model = model_of(estimate, CURRENTS)
    change = in_place(model, CURRENTS) - in_place(SensorCorrection())
    found = np.einsum("k,knc->nc", estimate[CHANNEL + "motor"], blocks[CHANNEL + "motor"].columns)
    np.testing.assert_allclose(found, change, atol=1e-15)
    np.testing.assert_allclose(model.currents["motor"], estimate[CHANNEL + "motor"] / CURRENTS["motor"].std())


def test_the_sensors_errors_are_those_that_the_correction_undoes():
    A, c = np.eye(3) + 0.05 * RNG.standard_normal((3, 3)), 2e-5 * RNG.standard_normal(3)
    M = np.linalg.inv(A)
    model = SensorCorrection(M, M @ c, 0.02)
    np.testing.assert_allclose(model.corrected(READINGS @ A.T + c), READINGS, atol=1e-18)
    np.testing.assert_allclose(model.hard_iron, c, atol=1e-18)
    np.testing.assert_allclose(model.soft_iron, A / np.cbrt(np.linalg.det(A)), atol=1e-12)
    turn = Rotation.from_rotvec([0.1, -0.05, 0.2])
    turned = SensorCorrection(turn.as_matrix().T, np.zeros(3))
    np.testing.assert_allclose(turned.misalignment, [0.1, -0.05, 0.2], atol=1e-12)
    assert not model.is_identity
    assert not SensorCorrection(time_offset=0.1).is_identity
    assert not SensorCorrection(currents={"motor": np.ones(3)}).is_identity


def test_a_correction_after_another_is_that_of_both_in_turn():
    first, second = (
        SensorCorrection(np.eye(3) + 0.05 * RNG.standard_normal((3, 3)), 1e-5 * RNG.standard_normal(3), t)
        for t in (0.01, 0.02)
    )
    both = second.after(first)
    np.testing.assert_allclose(both.corrected(READINGS), second.corrected(first.corrected(READINGS)), atol=1e-18)
    assert both.time_offset == 0.02


def test_a_correction_is_kept_as_it_was_and_one_that_is_none_is_refused():
    model = SensorCorrection(np.eye(3) + 0.01, np.array([1e-6, 0, 0]), 0.5)
    again = SensorCorrection.from_dict(model.as_dict())
    np.testing.assert_array_equal(again.matrix, model.matrix)
    np.testing.assert_array_equal(again.shift, model.shift)
    assert again.time_offset == 0.0
    for size in (0.4, 2.2):
        with pytest.raises(ValueError, match="near the identity"):
            SensorCorrection.from_dict(replace(model, matrix=size * np.eye(3)).as_dict())
    for shift in (np.array([np.nan, 0, 0]), np.zeros(2)):
        with pytest.raises(ValueError, match="near the identity"):
            SensorCorrection.from_dict(replace(model, shift=shift).as_dict())
