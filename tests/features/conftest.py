# SPDX-License-Identifier: BSD-3-Clause
"""Maps whose field is known exactly."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from exact_maps import I3, ExactPosterior, exact_map, room_of_dipoles, survey_in

BOX = np.array([2.4, 2.0, 0.6])


class Uneven(ExactPosterior):
    """Its variance grows along the model's x."""

    rim = 0.1

    def covariance(self, points, order=0):
        return 1e-14 * (2 + points[:, 0] / self.high[0])[:, None, None] * I3


@pytest.fixture(scope="session")
def make_map():
    """Map of a room, surveyed at random places (or given ones) in a frame of choice."""

    def make(seed, T_world_survey=None, x=None, sample_seed=None, source=None):
        T_world_survey = RigidTransform.identity() if T_world_survey is None else T_world_survey
        source = source or room_of_dipoles(seed, BOX, 30)
        if x is None:
            x = np.random.default_rng(seed if sample_seed is None else sample_seed).uniform(0, BOX, (600, 3))
        return exact_map(source, survey_in(source, x, T_world_survey), T_world_survey, Uneven)

    return make


@pytest.fixture(scope="session")
def make_room():
    return lambda seed, n=30: room_of_dipoles(seed, BOX, n)
