# SPDX-License-Identifier: BSD-3-Clause
"""What odometry adds to a pose that the field shows beside the path, not at a node."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.windows import bend, cut

CONFIG = SlamConfig(odometry=OdometryConfig(sd=(0.1, 2.0), scale_sd=0.01, turn_share=0.5))
S = np.linspace(0, 12.0, 241)
POSITIONS = np.column_stack([S, 0.3 * np.sin(S), 0 * S])


@pytest.fixture(scope="module")
def path():
    survey = Survey(POSITIONS, np.tile([2e-5, 0.0, -4e-5], (len(S), 1)), times=S)
    (path,) = cut([survey], 1.0, CONFIG)
    return path


def test_it_is_the_spread_of_many_walks(path):
    """A pose known exactly beside the end of a window, stated from the node in the window's middle."""
    k, last = 0, int(np.flatnonzero(path.number == 0)[-1])
    a = int(path.middles[k])
    other = RigidTransform.from_components(
        path.survey.positions[last] - path.centers[k] + [0.0, 0.5, 0.0], Rotation.from_rotvec([0, 0, 2.0])
    )
    stated = covariance_beside(path, k, other, CONFIG)
    loads = bend(path.survey.positions[a : last + 1], 0, CONFIG.odometry, upright=True, planar=False)[-1]
    shift = path.survey.positions[last] - path.centers[k]
    errors = np.random.default_rng(0).standard_normal((4000, loads.shape[1])) @ loads.T
    # Where the sample beside it truly is; the pose keeps its place relative to that.
    moved = RigidTransform.from_components(shift + errors[:, 3:], Rotation.from_rotvec(errors[:, :3]))
    off = (moved * RigidTransform.from_translation(-shift) * other).inv() * other
    sampled = np.cov(np.hstack([off.rotation.as_rotvec(), off.translation]).T)
    scale = np.sqrt(np.maximum(np.diagonal(stated), 1e-8))
    np.testing.assert_allclose(sampled / np.outer(scale, scale), stated / np.outer(scale, scale), atol=0.1)
    assert np.sqrt(stated[3, 3]) > 0.03


def test_odometry_that_is_stated_to_be_twice_as_good_is_so_in_its_lasting_turn_too(path):
    T = RigidTransform.from_translation(path.survey.positions[path.middles[1] + 40] - path.centers[1])
    exact = OdometryConfig(sd=(0.2, 4.0), scale_sd=0.0)
    C, D = (
        covariance_beside(path, 1, T, SlamConfig(odometry=exact.model_copy(update={"sd": sd})))
        for sd in ((0.2, 4.0), (0.1, 2.0))
    )
    np.testing.assert_allclose(D[2:5, 2:5], C[2:5, 2:5] / 4, rtol=1e-3, atol=1e-9)
