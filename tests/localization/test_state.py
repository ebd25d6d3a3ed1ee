# SPDX-License-Identifier: BSD-3-Clause
"""A hypothesis moves as odometry says, by the scale that it follows odometry under."""

import numpy as np

import magmatch as mm
from magmatch.geometry import skew
from magmatch.localization.state import PLACE, SCALE, hypotheses, model_of, predict


def test_a_step_is_of_the_odometry_s_length_times_its_scale_and_as_uncertain_as_turn_and_scale_make_it(known):
    model = model_of(known, mm.LocalizerConfig())._replace(
        place_walk=0.0, turn_walk=0.0, bent_walk=0.0, tilt_walk=0.0
    )
    turn_sd, scale_sd, f, u = np.array([0.01, 0.02, 0.03]), 0.05, 1.1, np.array([1.0, 2.0, 0.5])
    (one,) = hypotheses(1).view(np.recarray)
    one.scale = f - 1
    one.P[:] = np.diag(np.concatenate([turn_sd**2, np.zeros(SCALE - PLACE), [scale_sd**2]]))
    predict(one, np.eye(3), u, 1.0, known.up, model)
    np.testing.assert_allclose(one.p, f * u)
    J = np.column_stack([-f * skew(u) * turn_sd, scale_sd * u])
    np.testing.assert_allclose(one.P[3:6, 3:6], J @ J.T, atol=1e-12)
