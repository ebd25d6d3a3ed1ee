# SPDX-License-Identifier: BSD-3-Clause
"""Windows that odometry may bend as far as the field changes fit wherever they are laid: they close nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drifting import Place, drifting_walk, submap_at
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.result import SlamStatus
from magmatch.slam.run import slam
from magmatch.slam.search.loop_closure import SAME_SHIFT, Rough, matches


def test_logs_that_odometry_may_bend_at_will_stay_as_they_came_and_are_told_why():
    log, _ = drifting_walk(Place(1), 1)
    session = slam(log, SlamConfig(odometry=OdometryConfig(sd=(2.0, 4.0))))
    result = session.result()
    assert result.status is SlamStatus.UNCHANGED
    assert "odometry may bend" in result.reason
    assert "--odometry-sd" in result.reason
    assert not session.graph.closures


def test_an_error_of_scale_moves_points_along_what_lies_between_in_the_axes_of_the_walk(lone):
    for window in lone.session.paths[0].windows[:4]:
        x, moved = window.walk.positions, window.bending[:, 3:, -2]
        still = np.argmin(np.linalg.norm(moved, axis=1))
        np.testing.assert_allclose(moved, np.sqrt(2) * window.config.odometry.scale_sd * (x - x[still]), atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_window_that_is_bent_by_half_a_field_length_is_found_and_known_for_what_it_is(lone, seed):
    """The field is not linear over so much: the shape has to be fitted for the evidence to be seen."""
    places = lone.session._now
    closure = max(places.graph.closures, key=lambda c: c.log_odds)
    one = places.paths[0].windows[closure.second]
    odometry = OdometryConfig(sd=(0.6, 8.0), scale_sd=0.0, turn_share=0.0)
    window = replace(one, config=one.config.model_copy(update={"odometry": odometry}))
    assert 0.5 < window.bends_by / window.length < 0.6
    T = places.graph.center(closure.first) * closure.T_first_second * window.T_log_node.inv()
    rough = Rough(T, np.diag([0.01, 0.01, 0.1, 0.3, 0.3, 0.05]) ** 2)
    found = matches(bent(window, seed), submap_at(places, closure.first), rough)[0]
    off = found.T_base_log.apply(window.center) - T.apply(window.center)
    assert np.linalg.norm(off[:2]) < SAME_SHIFT * window.length
    assert found.log_odds > 5


def bent(window, seed):
    """The window as odometry may have bent it: with one draw of its errors."""
    errors = np.random.default_rng(seed).standard_normal(window.bending.shape[2])
    off, T = window.bending @ errors, window.walk.T_survey_walk
    bins, survey = T.apply(window.walk.positions), window.survey
    nearest = np.argmin(np.linalg.norm(survey.positions[:, None] - bins, axis=2), axis=1)
    turn, shift = (T.rotation.apply(part)[nearest] for part in (off[:, :3], off[:, 3:]))
    field = Rotation.from_rotvec(-turn).apply(survey.field)
    return replace(window, survey=replace(survey, positions=survey.positions - shift, field=field, orientations=None))
