# SPDX-License-Identifier: BSD-3-Clause
"""Points that a log marks itself, as its fixed points."""

from dataclasses import replace

import numpy as np

from drifting import Place, drifting_walk
from magmatch.data.formats.phones.phone_log import SurveyedPoints
from magmatch.slam.graph.anchors import WAYPOINT_SD, warn_of_floors, waypoints

LOG, _ = drifting_walk(Place(1), 1, laps=0.3)
START, END = float(LOG.times[0]), float(LOG.times[-1])


def points(*times, floor="1"):
    places = np.column_stack([np.arange(len(times)), np.zeros(len(times))])
    return SurveyedPoints(np.array(times), places, False, (floor,), "rows", np.arange(len(times)) + 5)


def test_points_without_samples_near_them_are_left_out_and_counted(caplog):
    found = waypoints(points(START - 1.1, START - 0.9, 2.0, END + 0.9, END + 5), LOG, "walk")
    assert [(a.log, a.t, a.sd) for a in found] == [("walk", t, WAYPOINT_SD) for t in (START - 0.9, 2.0, END + 0.9)]
    assert [a.source for a in found] == [f"walk.csv, line {k}" for k in (6, 7, 8)]
    assert "2 of its 5 surveyed points" in caplog.text


def test_a_point_is_as_high_as_odometry_has_the_log_there():
    climbing = replace(LOG, positions=LOG.positions + np.outer(LOG.times - START, [0, 0, 0.5]))
    (found,) = waypoints(points(START + 2.0), climbing, "walk")
    assert found.position[2] == np.float64(1.0)


def test_several_floors_are_warned_of_and_one_is_not(caplog):
    warn_of_floors([points(0.0), None, points(1.0)])
    assert not caplog.records
    warn_of_floors([points(0.0, floor="F3"), points(1.0)])
    assert "floors 1, F3, and are taken as of one" in caplog.text
