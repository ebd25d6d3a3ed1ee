# SPDX-License-Identifier: BSD-3-Clause
"""Fixed points: slopes, frames that they tell or do not, and one line for each that cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from drifting import Place, about_z, drifting_walk, trajectory_error
from magmatch.data.geodesy import Origin, local_east_north
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, fixed_points, in_metres, points_passed, read_anchors
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.solve import MOST_BENT, solve, strains
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.output.graph_files import write_graph
from magmatch.slam.places import Places
from magmatch.slam.result import SlamStatus
from magmatch.slam.run import slam
from magmatch.slam.statement import explain
from magmatch.slam.windows import cut

LEVEL = SlamConfig(is_planar=True)
LOG, TRUTH = drifting_walk(Place(1), 1, laps=1.0, turn=3.0)
# The surveyor's frame is none of the log's.
T = RigidTransform.from_components([20.0, -7.0, 3.0], about_z(2.1)[0])


def graph_of(rows, logs=(LOG,), config=LEVEL, sd=0.02, truths=(TRUTH,)):
    paths = cut(logs, 0.8, config)
    graph = odometry_graph(paths, config)
    anchors = [
        (Anchor(log.name, float(log.times[k]), T.apply(truth[k]), sd), n)
        for n, (log, truth) in enumerate(zip(logs, truths, strict=True))
        for k in rows
    ]
    graph.fixed = fixed_points(anchors, paths)
    solve(graph)
    return graph, paths


def test_points_that_lie_apart_tell_the_frame_and_correct_the_log():
    graph, (path,) = graph_of([5, 60, 110, 160, 205])
    there = corrected(path, graph).positions
    before = trajectory_error(TRUTH, LOG.positions)
    error = np.sqrt(((there - T.apply(TRUTH)) ** 2).sum(axis=1).mean())
    assert error < 0.5 * before  # in the surveyor's own frame: nothing was aligned
    assert graph.is_fixed(0)
    assert np.abs(graph.off_fixed()).max() < 0.06


def test_what_all_else_says_of_a_point_is_what_the_graph_without_it_says():
    rows = [5, 60, 110, 160, 205]
    graph, paths = graph_of(rows)
    off, covariance = graph.off_fixed_without()
    for k, row in enumerate(rows):
        without, _ = graph_of([other for other in rows if other != row])
        without.fixed = fixed_points([(Anchor(LOG.name, float(LOG.times[row]), T.apply(TRUTH[row]), 0.02), 0)], paths)
        sd = np.sqrt(np.trace(covariance[k]) / 3)
        assert np.linalg.norm(off[k] - without.off_fixed()[0]) < 0.2 * sd + 0.01


@pytest.mark.parametrize(("off", "is_bent"), [(0.0, False), (0.5, False), (5.0, True)])
def test_a_log_that_a_fixed_point_bends_by_more_than_its_odometry_can_drift_is_told(off, is_bent):
    graph, paths = graph_of([5, 60, 110, 160, 205])
    graph.fixed = replace(graph.fixed, position=graph.fixed.position + off * np.eye(5, 3, -1))
    solve(graph)
    assert (strains(graph)[0] > MOST_BENT) == is_bent
    reason = explain(SlamStatus.CONNECTED, Places(paths, graph, LEVEL), [[0]], ["walk"])
    assert ("walk: corrected by more than the drift of odometry makes possible" in reason) == is_bent


@pytest.mark.parametrize("at", [[5, 60, 110, 160, 205], [5, 60, 110]])
def test_a_point_that_all_else_contradicts_is_named(caplog, at):
    points = [Anchor("walk", float(LOG.times[k]), T.apply(TRUTH[k]), 0.05, f"points.csv, line {k}") for k in at]
    points[1] = replace(points[1], position=points[1].position + np.array([5.0, 0, 0]))
    session = slam(LOG, anchors=points)
    (said,) = (record.getMessage() for record in caplog.records if "all else" in record.getMessage())
    assert "line 60" in said
    of = session.result().anchors[1]
    # Its own residual, of a log that is drawn to it, does not show it.
    assert np.linalg.norm(of.off) < 0.5 < 4.0 < np.linalg.norm(of.off_without)


@pytest.mark.parametrize("sd", [1e-4, 1e-3, 0.3])
@pytest.mark.parametrize("rows", [[100], [3, 100]])
def test_rounding_says_nothing_against_a_point_that_nothing_else_places(rows, sd):
    graph, _ = graph_of(rows, sd=sd)
    _, covariance = graph.off_fixed_without()
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0 <= graph.surprise_of_fixed()[0] < 1e4  # of two points, the log's length may contradict one


def test_the_covariance_in_the_frame_of_fixed_points_covers_the_error():
    errors = []
    for seed in range(20):
        log, truth = drifting_walk(Place(1), seed, laps=1.0, turn=4.0, scale=0.0)
        rng = np.random.default_rng(seed)
        config = SlamConfig(
            is_planar=True, odometry={"sd": (0.01, 4.0 * np.sqrt(10)), "scale_sd": 0.001, "turn_share": 0.001}
        )
        paths = cut([log], 0.8, config)
        graph = odometry_graph(paths, config)
        anchors = [
            (Anchor("walk", float(log.times[k]), truth[k] + 0.05 * rng.normal(size=3), 0.05), 0)
            for k in (3, 100, 206)
        ]
        graph.fixed = fixed_points(anchors, paths)
        solve(graph)
        node = len(graph.p) // 2
        error = graph.R[node].T @ (graph.p[node] - truth[paths[0].middles[node]])
        C = graph.marginals()[node][3:5, 3:5]
        errors.append(error[:2] @ np.linalg.solve(C, error[:2]) / 2)
    assert 0.4 < np.mean(errors) < 2.0


def test_what_is_done_to_a_copy_leaves_the_graph_as_it_was():
    graph, _ = graph_of([10, 90, 200])
    was = [array.copy() for array in (graph.R, graph.p, graph.level)]
    other = graph.copied()
    other.fixed = replace(graph.fixed, position=graph.fixed.position + np.array([5.0, 0.0, 1.0]))
    solve(other)
    assert np.abs(other.p - graph.p).max() > 1
    for array, before in zip((graph.R, graph.p, graph.level), was, strict=True):
        np.testing.assert_array_equal(array, before)


def test_a_single_point_tells_where_and_not_which_way():
    graph, (path,) = graph_of([100])
    assert not graph.is_fixed(0)
    np.testing.assert_allclose(corrected(path, graph).positions[100], T.apply(TRUTH[100]), atol=0.02)
    # The log keeps its heading and its shape.
    np.testing.assert_allclose(np.diff(graph.p[:, :2], axis=0), np.diff(graph.start[:, :2], axis=0), atol=1e-3)


def test_logs_that_fixed_points_place_share_a_frame_without_a_closure():
    other, truth = drifting_walk(Place(5), 4, laps=0.8, name="other.csv")
    rows = [5, 80, 160]
    graph, paths = graph_of(rows, (LOG, other), truths=(TRUTH, truth))
    assert (graph.component() == 0).all()
    for path, true in zip(paths, (TRUTH, truth), strict=True):
        assert np.abs(corrected(path, graph).positions[rows] - T.apply(true[rows])).max() < 0.06


@given(st.floats(-3, 3), st.tuples(*[st.floats(-50, 50)] * 3))
@settings(max_examples=15, deadline=None)
def test_the_answer_moves_with_the_surveyors_frame(angle, shift):
    moved = RigidTransform.from_components(shift, about_z(angle)[0])
    paths = cut([LOG], 0.8, LEVEL)
    found = []
    for M in (RigidTransform.identity(), moved):
        graph = odometry_graph(paths, LEVEL)
        anchors = [(Anchor("walk", float(LOG.times[k]), M.apply(TRUTH[k]), 0.03), 0) for k in (5, 100, 200)]
        graph.fixed = fixed_points(anchors, paths)
        solve(graph)
        found.append(graph.p)
    np.testing.assert_allclose(found[1], moved.apply(found[0]), atol=2e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log,t,x,y,z\na,0,0,0,0\n", "missing sd"),
        ("log,t,x,y,z,sd\na,0,0,0,0,0\n", "line 2, column 'sd': expected a standard deviation above 0"),
        ("log,t,x,y,z,sd\na,0,nan,0,0,1\n", "line 2, column 'x'"),
        ("log,t,x,y,z,sd\na,0,0,0,0,1\na,noon,0,0,0,1\n", "line 3, column 't'"),
        ("log,t,lat,lon,z,sd\na,0,49,11,0,1\na,0,91,11,0,1\n", "line 3: found a latitude of 91"),
        ("log,t,lat,lon,sd\na,0,49,11,1\n", "missing z"),
        ("log,t,lat,y,z,sd\na,0,49,11,0,1\n", "(or lat, lon for x, y); missing x"),
    ],
)
def test_a_table_that_cannot_be_is_one_line(tmp_path, text, said):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(DataFormatError, match="points") as error:
        read_anchors(path)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("anchor", "said"),
    [
        (Anchor("robot", 1.0, np.zeros(3), 0.1, "points.csv, line 2"), "line 2: expected the name of a log"),
        (
            Anchor("walk.csv", -1.1, np.zeros(3), 0.1),
            r"expected a time between 0 and .* \(1 s more.* found -1.1",
        ),
    ],
)
def test_a_point_that_no_log_passed_is_refused(anchor, said):
    with pytest.raises(ConfigurationError, match=said):
        passed([anchor], LOG)
    with pytest.raises(ConfigurationError, match="no times" if anchor.log != "robot" else "name of a log"):
        passed([anchor], replace(LOG, times=None))


def passed(anchors, log):
    return points_passed(anchors, [log], ["walk"], 0, [], None, waypoints=False)[0]


@pytest.mark.parametrize("row", [0, -1])
def test_a_point_shortly_beyond_the_samples_counts_as_far_as_the_log_may_have_moved(row):
    times, (path,) = LOG.times, cut([LOG], 0.8, LEVEL)
    speed = path.walked[-1] / (times[-1] - times[0])
    near, at, beyond = (
        Anchor("walk", float(times[row]) + (late if row else -late), TRUTH[row], 0.1) for late in (-0.5, 0.0, 0.9)
    )
    assert passed([near, beyond], LOG) == [(near, 0), (beyond, 0)]
    found = fixed_points([(a, 0) for a in (near, at, beyond)], [path])
    np.testing.assert_allclose(found.sd, [0.1, 0.1, np.hypot(0.1, 0.9 * speed)])
    np.testing.assert_array_equal(found.x[2], LOG.positions[row])


def test_a_table_is_read_as_it_stands(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("# by the surveyor\nsd;z;y;x;t;log\n0.1;3;2;1;4.5;a b.csv\n\n0.2;0;0;0;5;c\n")
    one, other = read_anchors(path)
    assert (one.log, one.t, one.sd, one.position.tolist()) == ("a b.csv", 4.5, 0.1, [1, 2, 3])
    assert other.source.endswith("line 5")


def test_degrees_become_metres_about_the_first_point_or_a_stated_one(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("log,t,lat,lon,z,sd\na,0,49.46,11.11,2,1\na,1,49.461,11.112,3,1\n")
    degrees = read_anchors(path)
    points, origin = in_metres(degrees, None)
    assert origin == (49.46, 11.11)
    np.testing.assert_allclose(points[0].position, [0, 0, 2], atol=1e-9)
    east_north = local_east_north(np.array([49.461]), np.array([11.112]), Origin(49.46, 11.11))
    np.testing.assert_array_equal(points[1].position, [*east_north[0], 3])
    assert not points[1].in_degrees
    again, origin = in_metres(degrees, (49.461, 11.112))
    assert origin == (49.461, 11.112)
    np.testing.assert_allclose(again[1].position, [0, 0, 3], atol=1e-9)


def test_metres_and_degrees_share_a_frame_only_where_their_origin_is_stated():
    degrees, metres = Anchor("a", 0.0, [49.0, 11.0, 0.0], 0.1, "POSI", True), Anchor("a", 1.0, [5, 6, 0], 0.1, "CSV")
    with pytest.raises(ConfigurationError, match="CSV: is in metres, POSI in degrees"):
        in_metres([degrees, metres], None)
    with pytest.raises(ConfigurationError, match="CSV: is in metres"):
        in_metres([degrees], None, [metres])
    both, _ = in_metres([degrees, metres], (49.0, 11.0))
    np.testing.assert_allclose([a.position for a in both], [[0, 0, 0], [5, 6, 0]], atol=1e-9)


@pytest.mark.parametrize(
    "wrong", [{"sd": 0.0}, {"sd": np.nan}, {"t": np.inf}, {"position": [0, 0]}, {"position": [0, np.nan, 0]}]
)
def test_numbers_that_no_fixed_point_has_are_refused(wrong):
    with pytest.raises(ValueError, match="expected"):
        Anchor(**({"log": "walk", "t": 0.0, "position": [0, 0, 0], "sd": 0.1} | wrong))


def test_fixed_points_stand_in_g2o_where_the_graph_has_them(tmp_path):
    graph, _ = graph_of([10, 90, 150, 200], sd=0.3)
    write_graph(graph, tmp_path / "graph.g2o")
    rows = [line.split() for line in (tmp_path / "graph.g2o").read_text().splitlines() if line[0] != "#"]
    n, poses = len(graph.p), [np.array(r[2:9], float) for r in rows if r[0] == "VERTEX_SE3:QUAT"]
    T = [RigidTransform.from_components(v[:3], Rotation.from_quat(v[3:])) for v in poses]
    edges = [(int(r[1]), int(r[2]), np.array(r[3:], float)) for r in rows if r[0] == "EDGE_SE3:QUAT"]
    seen = {j: (i, v) for i, j, v in edges if i < n <= j}
    np.testing.assert_allclose([T[j].translation for j in seen], graph.fixed.position)
    # The nearer node alone says nearly what both say.
    off = [T[i].apply(v[:3]) - T[j].translation for j, (i, v) in seen.items()]
    assert np.linalg.norm(off) == pytest.approx(np.linalg.norm(graph.off_fixed()), rel=0.3)
    assert [v[7] for _, v in seen.values()] == pytest.approx([0.3**-2] * 4)
    tied = [(v[:3], T[j].translation - T[i].translation) for i, j, v in edges if i == n]
    assert len(tied) == 3
    np.testing.assert_allclose(*zip(*tied, strict=True))


@pytest.mark.parametrize("is_swapped", [False, True])
def test_a_mirrored_plan_of_fixed_points_is_told(is_swapped, caplog):
    walk, truth = drifting_walk(Place(1), 1)
    turned = truth[:, :2] @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + 50  # the plan's own frame
    plan = turned[:, ::-1] if is_swapped else turned * [1, -1]
    for places, n, is_told in ((plan, 6, True), (turned, 6, False), (plan, 3, False)):
        at = np.linspace(5, len(walk) - 5, n).astype(int)
        points = [Anchor("walk", walk.times[k], np.array([*places[k], 0.0]), 0.1) for k in at]
        caplog.clear()
        passed(points, walk)
        assert ("fit its path mirrored" in caplog.text) is is_told
