# SPDX-License-Identifier: BSD-3-Clause
"""Windows that odometry may bend as far as the field changes fit wherever they are laid: they close nothing."""

from drifting import Place, drifting_walk
from magmatch.slam.config import OdometryConfig, SlamConfig
from magmatch.slam.result import SlamStatus
from magmatch.slam.run import slam


def test_logs_that_odometry_may_bend_at_will_stay_as_they_came_and_are_told_why():
    log, _ = drifting_walk(Place(1), 1)
    session = slam(log, SlamConfig(odometry=OdometryConfig(sd=(2.0, 4.0))))
    result = session.result()
    assert result.status is SlamStatus.UNCHANGED
    assert "odometry may bend" in result.reason
    assert "--odometry-sd" in result.reason
    assert not session.graph.closures


def test_a_window_bends_by_more_the_worse_odometry_is(lone):
    (window, *_) = lone.session.paths[0].windows
    assert window.keeps_shape
    assert 0 < window.bends_by < window.length
