# SPDX-License-Identifier: BSD-3-Clause
"""Another place shares the Earth's field with the map, and may be smoother: neither is evidence for being in it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magmatch as mm
from drifting import about_z
from magmatch.localization.bins import STEP
from magmatch.localization.measurement import FIT
from magmatch.localization.null_model import UnrelatedFields
from magmatch.localization.state import model_of


def likelihood(known, field, config):
    """Log of the mean likelihood of unrelated fields where a body stands in a field, (3,), T, by odometry's axes."""
    step, null = np.zeros(1, STEP), UnrelatedFields(known, model_of(known, config), config)
    step["R"], step["M"], step["z"] = np.eye(3), np.eye(3), field
    fit = np.zeros((1, len(null.now)), FIT)
    null.follow(step, fit)
    return float(np.logaddexp.reduce(-0.5 * fit["chi2"][0] - fit["half_log_det"][0]) - np.log(len(null.now)))


def of_the_map(known):
    """Mean field in axes whose z is up."""
    return known.T_map_model[:3, :3] @ known.mean_field


@pytest.mark.parametrize("is_gravity_aligned", [True, False])
def test_the_earths_field_from_any_heading_is_as_likely(known, is_gravity_aligned):
    config = mm.LocalizerConfig(is_gravity_aligned=is_gravity_aligned)
    turns = Rotation.random(6, random_state=0) if not is_gravity_aligned else about_z(np.arange(6.0))
    found = [likelihood(known, turn.apply(of_the_map(known)), config) for turn in turns]
    np.testing.assert_allclose(found, found[0], atol=1e-6)


def test_the_earths_field_is_likelier_than_one_that_points_up(known):
    config, usual = mm.LocalizerConfig(), of_the_map(known)
    assert likelihood(known, usual, config) > likelihood(known, usual * [1, 1, -1], config) + 1
    free = config.model_copy(update={"is_gravity_aligned": False})
    assert likelihood(known, usual, free) == pytest.approx(likelihood(known, usual * [1, 1, -1], free), abs=1e-6)


def test_a_poor_maps_errors_are_not_asked_of_another_place(known):
    # Errors of 6 uT explain a smooth walk badly; so would the map, which must not win for it.
    config, model = mm.LocalizerConfig(), model_of(known, mm.LocalizerConfig())
    poor = model._replace(misfit_variance=6e-6**2, nugget_variance=3e-6**2)
    steps, null = np.zeros(20, STEP), UnrelatedFields(known, poor, config)
    steps["R"], steps["M"], steps["z"], steps["u"][:, 0] = np.eye(3), np.eye(3), of_the_map(known), 0.3
    fit = np.zeros((len(steps), len(null.now)), FIT)
    null.follow(steps, fit)
    found = (-0.5 * fit["chi2"] - fit["half_log_det"]).sum(axis=0)
    as_rough = null._start["nugget"] >= poor.nugget_variance
    assert as_rough.any()
    assert np.logaddexp.reduce(found) - np.log(len(found)) > found[as_rough].max() + 10


def test_a_heading_need_not_be_known_as_well_as_a_surveys_frame():
    ours, theirs = mm.LocalizerConfig(), mm.RegistrationConfig().decision
    assert ours.decision.max_sd(1.0) == (2.0, pytest.approx(np.radians(30), abs=1e-4))
    # Nor does a coarse pose that will do make one answer of two.
    assert ours.same(1.0) == (theirs.tolerance(1.0)[0], pytest.approx(2 * theirs.tolerance(1.0)[1]))
