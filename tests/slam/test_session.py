# SPDX-License-Identifier: BSD-3-Clause
"""What a session says of itself: the document, the folder, and the graph for other programs."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from drifting import trajectory_error
from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.estimation.path_noise import PRIOR_STRETCHES
from magmatch.field.sensor_biases import SensorBiases, without_bias
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.registration.g2o import g2o_information
from magmatch.runner import Runner
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.normal_equations import shared
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.output.folder import require_folder, write_folder
from magmatch.slam.output.graph_files import write_covariances, write_graph
from magmatch.slam.places import settled
from magmatch.slam.result import SlamStatus
from magmatch.slam.search.loop_closure import Candidate, Match
from magmatch.slam.statement import explain

KEYS = [
    "schema", "status", "reason", "logs", "closures", "anchors", "odometry", "seconds", "config", "version", "seed",
    "inputs",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(three, tmp_path_factory):
    place = tmp_path_factory.mktemp("sessions") / "out"
    write_folder(three.session, place)
    return place


def test_the_document_has_the_keys_of_the_contract(folder):
    document = json.loads((folder / "result.json").read_text())
    assert [key for key in document if key != "checksum"] == KEYS
    assert document["schema"] == "magmatch.slam/1"
    assert set(document["logs"][0]) == {
        "name", "component", "T_map_log", "length", "n_closures", "moved", "sd", "is_fixed",
    }  # fmt: skip
    assert set(document["closures"][0]) >= {
        "log_a", "t_a", "log_b", "t_b", "T_a_b", "covariance", "probability", "weight",
    }  # fmt: skip


def test_logs_that_hang_together_are_placed_and_a_stranger_is_not(three):
    result = three.session.result()
    assert result.status is SlamStatus.PARTLY_CONNECTED
    a, b, c = result.logs
    assert (a.component, b.component) == (0, 0)
    assert c.component == 1
    assert c.T_map_log is None
    assert "c" in result.reason
    assert b.T_map_log is not None
    first = three.session.trajectories[1].positions[0]
    np.testing.assert_allclose(b.T_map_log.apply(three.logs[1].positions[0]), first, atol=1e-9)
    assert b.sd[0] > 0.02
    assert b.n_closures > 0
    assert sorted(map(sorted, three.session.components)) == [[0, 1], [2]]
    joint = np.concatenate([path.positions for path in three.session.trajectories[:2]])
    apart = max(trajectory_error(three.truth[k], three.logs[k].positions) for k in (0, 1))
    assert trajectory_error(np.concatenate(three.truth[:2]), joint) < 0.8 * apart


def test_a_drift_that_is_neither_stated_nor_learned_is_said_to_be_assumed(lone, many_laps):
    """It decides what few closures are found, and a user may know better."""
    assert "0.3 m and 4 degrees in 10 m: state yours with --odometry-sd" in lone.session.result().reason
    assert len(many_laps.session.graph.closures) >= PRIOR_STRETCHES
    assert "--odometry-sd" not in many_laps.session.result().reason
    stated = SlamConfig(sd_of_logs={lone.log.name: (0.3, 4.0)})
    of_this_log = replace(lone.session, places=replace(lone.session.places, stated=stated))
    for session in (mm.slam(lone.log, SlamConfig(odometry=OdometryConfig(sd=(0.2, 3.0)))), of_this_log):
        assert 0 < len(session.graph.closures) < PRIOR_STRETCHES
        assert "--odometry-sd" not in session.result().reason


def test_closures_are_said_between_bodies(lone):
    result, session = lone.session.result(), lone.session
    (path,), survey = session.paths, lone.log
    for stated, c in zip(result.closures, session.graph.closures, strict=True):
        at = [int(np.searchsorted(survey.times, t)) for t in (stated.t_a, stated.t_b)]
        assert at == [int(path.middles[c.first]), int(path.middles[c.second])]
        T_a, T_b = (RigidTransform.from_rotation(survey.orientations[k]) for k in at)
        np.testing.assert_allclose((T_a * stated.T_a_b).as_matrix(), (c.T_first_second * T_b).as_matrix(), atol=1e-12)
        assert stated.walked_b > stated.walked_a


def test_the_folder_holds_what_the_contract_says(folder, three):
    names = {path.name for path in folder.iterdir()}
    assert names == {f"{n}.{e}" for n in "abc" for e in ("csv", "tum")} | {
        "map.map", "map_2.map", "graph.g2o", "covariances.csv", "result.json", "session.state",
    }  # fmt: skip
    for name, survey, truth in zip("abc", three.session.trajectories, three.truth, strict=True):
        poses, there = mm.Trajectory.load(folder / f"{name}.tum"), read_survey(folder / f"{name}.csv")
        np.testing.assert_array_equal(poses.times, survey.times)
        np.testing.assert_array_equal(there.positions, poses.positions)
        assert trajectory_error(truth, poses.positions) < 1.0
    assert len(mm.FieldMap.load(folder / "map.map").surveys) == 2


def test_the_folder_states_and_takes_out_the_biases_that_the_map_solved(three, tmp_path, monkeypatch):
    session = three.session
    before = session.result().to_dict()["odometry"]["logs"]
    old = [bias for bias, _ in session.map_biases]
    found = SensorBiases(np.array([[3e-6, -2e-6, 1e-6], [0, 4e-6, 5e-6]]), np.full((2, 3), 2e-7), 4e-6)
    monkeypatch.setitem(session._maps, 0, replace(session.map(), biases=found))
    result = write_folder(session, tmp_path / "out").to_dict()["odometry"]["logs"]
    for k, name in enumerate("ab"):
        stated = np.subtract(result[name]["bias"], before[name]["bias"])
        np.testing.assert_allclose(stated, found.bias[k] - old[k], atol=1e-15)
        assert result[name]["bias_sd"] == found.sd[k].tolist()
        there, survey = read_survey(tmp_path / f"out/{name}.csv"), session.trajectories[k]
        np.testing.assert_allclose(there.field, without_bias(survey, found.bias[k]).field, atol=1e-12)
    assert result["c"] == before["c"]


def test_an_earlier_result_of_the_same_logs_is_replaced_and_nothing_else(folder, lone, three, tmp_path):
    mine = folder / "notes.txt"
    mine.write_text("mine")
    write_folder(three.session, folder)
    assert mine.read_text() == "mine"
    with pytest.raises(DataFormatError, match="other inputs"):
        write_folder(lone.session, folder)
    with pytest.raises(DataFormatError, match=r"other inputs: b.csv is not given"):
        require_folder(folder, [three.logs[0], three.logs[2]])
    with pytest.raises(DataFormatError, match=r"other inputs: b.csv was changed"):
        require_folder(folder, [three.logs[0], replace(lone.log, name="b.csv"), three.logs[2]])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("years of work")
    with pytest.raises(DataFormatError, match="not empty"):
        write_folder(lone.session, tmp_path / "full")
    with pytest.raises(DataFormatError, match="is a file"):
        write_folder(lone.session, tmp_path / "full" / "thesis.tex")
    with pytest.raises(DataFormatError, match="create it first"):
        write_folder(lone.session, tmp_path / "no" / "where")
    with pytest.raises(DataFormatError, match="holds an input"):
        require_folder(folder, three.session.given, [folder / "a.csv"])
    assert not [p for p in [*tmp_path.iterdir(), *folder.parent.iterdir()] if p.name.startswith(".")]


def test_a_writer_that_fails_leaves_nothing(lone, tmp_path):
    def fail(*_):
        msg = "disk full"
        raise OSError(msg)

    with pytest.raises(OSError, match="disk full"):
        write_folder(lone.session, tmp_path / "out", fail)
    assert not list(tmp_path.iterdir())


def test_logs_that_nothing_connects_may_be_tilted(three):
    places = three.session.places
    names, apart = three.session.names, [[0, 1], [2]]

    def said(status, **settings):
        stated = replace(places, stated=places.stated.model_copy(update=settings))
        return explain(status, stated, apart, names)

    for status in (SlamStatus.UNCHANGED, SlamStatus.PARTLY_CONNECTED):
        assert "if z is not up in all logs, say --no-gravity" in said(status, is_planar=False)
        assert "--no-gravity" not in said(status, is_planar=True)
        assert "--no-gravity" not in said(status, is_planar=False, is_gravity_aligned=False)


def test_names_are_stems_and_never_twice_the_same(lone):
    def named(*names):
        return replace(lone.session, given=[replace(lone.log, name=name) for name in names]).names

    assert named("walk.csv", "walk.bag", "Walk.csv") == ["walk", "walk_2", "Walk_3"]
    assert named("a/b/../c.csv", "", "walk_2", "walk.csv", "walk.mat") == ["c", "log", "walk_2", "walk", "walk_3"]


@pytest.mark.parametrize("tangent", ["quaternion", "angle"])
def test_the_graph_read_as_g2o_is_the_graph(lone, tmp_path, tangent):
    graph = lone.session.graph
    write_graph(graph, tmp_path / "graph.g2o", tangent)
    rows = [line.split() for line in (tmp_path / "graph.g2o").read_text().splitlines() if line[0] != "#"]
    vertices = {int(r[1]): np.array(r[2:], float) for r in rows if r[0] == "VERTEX_SE3:QUAT"}
    edges = [(int(r[1]), int(r[2]), np.array(r[3:], float)) for r in rows if r[0] == "EDGE_SE3:QUAT"]
    assert len(vertices) == len(graph.p)
    assert len(edges) == len(graph.edges.first) + len(graph.closures)
    poses = {k: RigidTransform.from_components(v[:3], Rotation.from_quat(v[3:])) for k, v in vertices.items()}
    np.testing.assert_allclose([poses[k].translation for k in range(len(poses))], graph.p, atol=1e-12)
    # Without the maps of several passes, which g2o cannot express.
    weights = graph.as_arrays.weight / shared(graph)
    for (i, j, numbers), c, counts in zip(edges[len(graph.edges.first) :], graph.closures, weights, strict=True):
        assert (i, j) == (c.first, c.second)
        Z = RigidTransform.from_components(numbers[:3], Rotation.from_quat(numbers[3:7]))
        np.testing.assert_allclose(Z.as_matrix(), c.T_first_second.as_matrix(), atol=1e-12)
        stated = counts * g2o_information(c.covariance, tangent)[np.triu_indices(6)]
        np.testing.assert_allclose(numbers[7:], stated, rtol=1e-4, atol=1e-6 * np.abs(stated).max())


def test_a_pass_closes_with_a_window_once(three):
    """What is weighed again with more windows may favour a node beside the one that is tied: the same evidence."""
    places = three.session.places.copied()
    path = places.paths[1]
    closure = next(c for c in places.graph.closures if c.second in path.nodes)
    here = RigidTransform.identity()
    for first in (closure.first, closure.first + 1):
        T = places.graph.pose(first).inv() * places.graph.pose(closure.first) * closure.T_first_second
        sure = Match(here, closure.covariance, 12.0, -2.0, here, closure.covariance)
        candidates = [[Candidate(first, T, sure)] if n == closure.second else [] for n in path.nodes]
        assert LoopCloser(places, Runner()).close(path, candidates) == 0


@pytest.mark.parametrize(
    ("given", "kind", "said"),
    [
        ({"anchors": [("walk", 1.0)]}, TypeError, r"anchors\[0\]"),
        ({"run": 3}, TypeError, "run: expected a callable"),
        ({"keep": "no/such/folder"}, ConfigurationError, "keep: the folder .*such does not exist"),
    ],
)
def test_options_that_cannot_be_are_refused_before_any_work(lone, given, kind, said):
    with pytest.raises(kind, match=said):
        mm.slam(lone.log, **given)


def test_a_component_that_is_none_is_refused(lone):
    with pytest.raises(ValueError, match="component: expected a whole number from 0 to 0"):
        lone.session.map(3)


def test_logs_stated_as_planar_that_lie_at_two_heights_are_warned_of(lone, caplog):
    other = replace(lone.log, positions=lone.log.positions + np.array([0.0, 0.0, 1.2]), name="high.csv")
    assert settled([lone.log, other], SlamConfig()) == SlamConfig()
    planar = SlamConfig(is_planar=True)
    assert settled([lone.log, other], planar) == planar
    assert "stated as planar, but heights go from" in caplog.text


def test_a_log_at_another_height_is_joined_when_it_is_added_as_when_all_are_given(lone, three, caplog):
    b = three.logs[1]
    high = replace(b, positions=b.positions + np.array([0.0, 0.0, 3.0]))
    session = replace(lone.session)
    assert session.config.is_planar
    session.add_log(high)
    assert "b.csv: lies at another height" in caplog.text
    assert not session.config.is_planar
    assert len(session.components) == 1
    assert len(mm.slam([lone.log, high]).components) == 1


def test_a_live_walk_whose_end_was_interrupted_is_finished_again(lone):
    log = lone.log.subset(slice(120))

    def interrupted(*_):
        raise KeyboardInterrupt

    session = mm.Session()
    poses = RigidTransform.from_components(log.positions, log.orientations)
    b = log.orientations.apply(log.field, inverse=True)
    for k, t in enumerate(log.times):
        session.add(float(t), poses[k], b[k])
    with pytest.raises(KeyboardInterrupt):
        session.finish("walk", progress=interrupted)
    session.pose()
    session.finish("walk")
    assert session.names == ["walk"]
    assert len(session.logs[0]) == len(log)


def test_a_first_sample_that_is_refused_begins_no_log(lone):
    session = mm.Session()
    with pytest.raises(ValueError, match=r"at most 0\.1 T"):
        session.add(0.0, RigidTransform.identity(), [0.0, 0.0, 50.0])
    session.add_log(lone.log.subset(slice(80)))
    assert len(session.logs) == 1


def test_the_drift_of_a_log_is_stated_by_its_name_or_its_stem():
    for name in ("walk.csv", "walk"):
        config = SlamConfig(sd_of_logs={name: (0.05, 0.5)})
        assert config.odometry_of("walk.csv").sd == (0.05, 0.5)
        assert config.odometry_of("other.csv").sd == OdometryConfig().sd


def test_fixed_points_that_are_given_again_count_once(lone):
    point = Anchor("walk", float(lone.log.times[30]), np.zeros(3), 0.1)
    session = mm.slam(lone.log.subset(slice(80)), anchors=[point])
    session.add_logs([], anchors=[point])
    assert len(session.places.anchors) == 1


def test_seconds_of_a_stage_that_was_not_repeated_stay_as_they_were(lone):
    session = mm.slam(lone.log.subset(slice(80)))
    numbers = session.seconds["numbers"]
    session.add_logs([])
    assert session.seconds["numbers"] == numbers


def test_fixed_points_of_a_log_whose_field_tells_nothing_stay_when_another_is_added(lone):
    log = lone.log.subset(slice(80))
    constant = replace(log, field=np.tile([2e-5, 0.0, -4.5e-5], (len(log), 1)), name="constant")
    session, point = mm.Session(), Anchor("constant", float(log.times[30]), np.zeros(3), 0.1)
    session.add_logs([constant], [point])
    session.add_logs([replace(constant.subset(slice(40)), name="second")], [point])
    assert len(session.places.anchors) == 1


def test_covariances_are_those_of_poses_in_the_trajectory(lone, tmp_path):
    write_folder(lone.session, tmp_path / "out")
    header, *rows = (tmp_path / "out" / "covariances.csv").read_text().splitlines()
    cells = [dict(zip(header.split(","), row.split(","), strict=True)) for row in rows]
    (path,), (after,) = lone.session.paths, lone.session.trajectories
    assert len(cells) == len(path.windows)
    sds = lone.session.standard_deviations(path.nodes)
    for cell, node, middle in zip(cells, path.nodes, path.middles, strict=True):
        # To the last bit: nine digits of a Unix time are 10 s, and of a northing 1 cm.
        assert float(cell["t"]) == after.times[middle]
        T = lone.session.graph.pose(node) * lone.session._now.body_at(node)[0]
        assert [float(cell[k]) for k in "xyz"] == T.translation.tolist()
        np.testing.assert_allclose([float(cell[k]) for k in "xyz"], after.positions[middle], atol=1e-6)
        q = Rotation.from_quat([float(cell[f"q{k}"]) for k in "xyzw"])
        assert (q.inv() * after.orientations[middle]).magnitude() < 1e-6
    variances = np.array([[float(cell[f"c{k}{k}"]) for k in range(6)] for cell in cells])
    stated = np.sqrt(np.column_stack([variances[:, 3:].sum(axis=1), variances[:, :3].sum(axis=1)]))
    np.testing.assert_allclose(stated, sds, rtol=1e-6, atol=1e-9)


def test_covariances_are_a_table_whatever_a_log_is_called(lone, tmp_path, monkeypatch):
    monkeypatch.setattr(mm.Session, "names", property(lambda _: ['a "b", c']))
    write_covariances(lone.session, tmp_path / "covariances.csv")
    with (tmp_path / "covariances.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["log"] for row in rows} == {'a "b", c'}
    assert all(None not in row and float(row["c55"]) >= 0 for row in rows)
