# SPDX-License-Identifier: BSD-3-Clause
"""Points that a log marks itself, as its fixed points."""

from dataclasses import replace

import numpy as np

import magmatch as mm
from drifting import Place, drifting_walk
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.slam.graph.anchors import WAYPOINT_SD, Anchor, waypoints, waypoints_of

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
    first, other = (replace(LOG, waypoints=points(START, floor=floor)) for floor in ("1", "F3"))
    waypoints_of([first, LOG, first], ["a", "b", "c"], is_tied=True)
    assert "floors" not in caplog.text
    waypoints_of([first, other], ["a", "b"], is_tied=True)
    assert "floors 1, F3, and are taken as of one" in caplog.text


FLAT = replace(LOG, field=np.tile([2e-5, 0, -4.5e-5], (len(LOG), 1)))  # of which no submap is made


def test_python_slam_uses_the_points_that_logs_hold_unless_told_otherwise():
    log = replace(FLAT, waypoints=points(START - 0.1, END))
    found = mm.slam([log]).result()
    assert [(a.log, a.t) for a in found.anchors] == [("walk", START - 0.1), ("walk", END)]
    assert mm.slam([log], waypoints=False).result().anchors == ()


def test_points_of_a_log_added_later_are_used_too():
    session = mm.slam([replace(LOG, waypoints=points(START, END))])
    session.add_log(replace(LOG.subset(slice(1, None)), name="later.csv", waypoints=points(START + 1, END)))
    assert [a.log for a in session.result().anchors] == ["walk", "walk", "later", "later"]


def test_points_in_degrees_are_used_beside_others_in_metres_only_if_an_origin_ties_them(caplog):
    log = replace(FLAT, waypoints=replace(points(START, END), in_degrees=True))
    table = [Anchor("walk", END, np.zeros(3), 0.1)]
    assert len(mm.slam([log]).result().anchors) == 2
    assert "not used" not in caplog.text
    assert len(mm.slam([log], anchors=table).result().anchors) == 1
    assert "points in degrees that logs hold are not used" in caplog.text
    assert len(mm.slam([log], mm.SlamConfig(origin=(0, 0)), anchors=table).result().anchors) == 3


def test_a_map_is_saved_without_the_points_of_its_logs(tmp_path):
    with_points = replace(LOG, waypoints=points(START, END))
    settings = mm.FieldConfig(prior="spline", lengthscale=1.0, signal_sd=5e-6, noise_sd=5e-7, spacing=0.5)
    mm.build_map(with_points, settings).save(tmp_path / "a.map")
    mm.build_map(LOG, settings).save(tmp_path / "b.map")
    assert (tmp_path / "a.map").read_bytes() == (tmp_path / "b.map").read_bytes()
    assert mm.FieldMap.load(tmp_path / "a.map").survey.waypoints is None
