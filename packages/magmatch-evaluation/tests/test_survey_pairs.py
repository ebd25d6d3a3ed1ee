# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of the published experiments: one place whose noise alone is drawn anew, and frames turned as stated."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.survey_pairs import OnePlace, Simulated, TurnedPairs

pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")

FEW = SimulationConfig(n_samples=300)


def test_noise_alone_is_drawn_anew_in_one_place():
    make = OnePlace("office-random", FEW)
    one, other, again = (make(seed) for seed in (5, 6, 5))
    np.testing.assert_array_equal(one.target.positions, other.target.positions)
    np.testing.assert_array_equal(one.target.field, again.target.field)
    for side in ("base", "target"):
        noise = getattr(one, side).field - getattr(other, side).field
        assert np.std(noise) == pytest.approx(np.sqrt(2) * FEW.noise_sd, rel=0.1)
    assert not np.allclose(one.base.field - other.base.field, one.target.field - other.target.field)


def test_a_pair_may_be_the_same_for_all_seeds():
    make = OnePlace("office-random", FEW, is_noise_drawn=False)
    np.testing.assert_array_equal(make(5).target.field, make(6).target.field)
    np.testing.assert_array_equal(make(5).target.field, Simulated("office-random", FEW)(make.place).target.field)


def test_a_turned_pair_has_the_stated_turn_and_is_the_same_pair():
    given = Simulated("office-random", FEW)(3)
    turned = TurnedPairs(Simulated("office-random", FEW), "x", -30.0)(3)
    truth = turned.T_base_target
    assert (truth.rotation * Rotation.from_euler("x", 30, degrees=True)).magnitude() < 1e-12
    for pair in (given, turned):
        in_base = pair.T_base_target.apply(pair.target.positions)
        np.testing.assert_allclose(in_base, given.T_base_target.apply(given.target.positions), atol=1e-9)
        field = pair.T_base_target.rotation.apply(pair.target.field)
        np.testing.assert_allclose(field, given.T_base_target.rotation.apply(given.target.field), atol=1e-15)
