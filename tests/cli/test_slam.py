# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch slam`` and ``magmatch merge``: exit codes, what is left in the folder, and what is refused."""

import json
import shutil
import sys

import numpy as np
import pytest

import magmatch as mm
from drifting import GIVEN, Place, drifting_walk, trajectory_error
from magmatch.cli.main import main
from magmatch.slam.result import SlamResult

pytest.importorskip("plotly", reason="the report is drawn with the extra 'viz'")
# All but the folder that is made once.
pytestmark = pytest.mark.usefixtures("numbers_are_given")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """walk.csv twice round, short.csv not once, in a folder."""
    folder = tmp_path_factory.mktemp("logs")
    walk, truth = drifting_walk(Place(1), 1)
    walk.save(folder / "walk.csv")
    np.save(folder / "truth.npy", truth)
    drifting_walk(Place(1), 1, laps=0.7)[0].save(folder / "short.csv")
    return folder


@pytest.fixture(scope="module")
def corrected(logs):
    """The folder that slam makes of walk.csv."""
    assert main(["slam", str(logs / "walk.csv"), "--out", str(logs / "out")]) == 0
    return logs / "out"


def test_a_log_is_corrected_and_the_folder_holds_all_of_it(logs, corrected):
    names = {path.name for path in corrected.iterdir()}
    assert mm.FieldMap.load(corrected / "map.map").hyperparameters.lengthscale not in (None, GIVEN.lengthscale)
    files = "walk.tum walk.csv map.map graph.g2o covariances.csv report.html result.json session.state"
    assert names == set(files.split())
    truth = np.load(logs / "truth.npy")
    before, after = mm.read_survey(logs / "walk.csv"), mm.Trajectory.load(corrected / "walk.tum")
    assert trajectory_error(truth, after.positions) < 0.7 * trajectory_error(truth, before.positions)
    page = (corrected / "report.html").read_text()
    assert "Connected" in page
    assert "Where the graph is weak" in page


def test_poses_of_a_file_of_their_own_come_back_at_their_own_times(run, logs, tmp_path):
    walk = mm.read_survey(logs / "walk.csv")
    few = np.arange(0, len(walk), 3)
    mm.Trajectory(walk.times[few], walk.positions[few], walk.orientations[few]).save(tmp_path / "poses.tum")
    rows = np.column_stack([walk.times, walk.orientations.inv().apply(walk.field)])
    np.savetxt(tmp_path / "field.csv", rows, delimiter=",", header="t,bx,by,bz", comments="")
    done = run(
        "slam", tmp_path / "field.csv", "--trajectory", tmp_path / "poses.tum", "--field-frame", "sensor",
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert done.code == 0, done.err
    poses = mm.Trajectory.load(tmp_path / "out" / "field.tum")
    np.testing.assert_array_equal(poses.times, walk.times[few])
    truth = np.load(logs / "truth.npy")[few]
    assert trajectory_error(truth, poses.positions) < 0.7 * trajectory_error(truth, walk.positions[few])


def test_a_log_that_passes_nothing_twice_is_left_as_it_came(run, logs, tmp_path):
    done = run("slam", logs / "short.csv", "--odometry-sd", "0.2,2", "--out", tmp_path / "out")
    assert done.code == 3, done.err
    assert "Unchanged" in done.err
    result = SlamResult.load(tmp_path / "out" / "result.json")
    assert result.status == "unchanged"
    assert result.odometry["sd"] == (0.2, 2.0)
    poses = mm.Trajectory.load(tmp_path / "out" / "short.tum")
    np.testing.assert_allclose(poses.positions, mm.read_survey(logs / "short.csv").positions, atol=1e-6)
    # Again, into the same folder, with the settings of the first time.
    (tmp_path / "earlier.json").write_bytes((tmp_path / "out" / "result.json").read_bytes())
    tum, more = (tmp_path / "out" / "short.tum").read_bytes(), ("--config", tmp_path / "earlier.json", "--json")
    again = run("slam", logs / "short.csv", "--out", tmp_path / "out", *more)
    assert again.code == 3
    assert "planar" in again.err
    assert json.loads(again.out) == SlamResult.load(tmp_path / "out" / "result.json").to_dict()
    assert json.loads(again.out)["odometry"]["sd"] == [0.2, 2.0]
    assert (tmp_path / "out" / "short.tum").read_bytes() == tum


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["{logs}/walk.csv"], "--out"),
        (["{logs}/truth.npy", "--out", "{tmp}/out"], "truth.npy"),
        (["{logs}/walk.csv", "--out", "{logs}"], "holds an input"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--odometry-sd", "0.3"], "metres,degrees"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--odometry-sd", "-1,2"], "none below 0"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--odometry-sd", "robot:1,2"], "name of a log"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--planar", "--no-gravity"], "--no-gravity"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--g2o-rotation", "euler"], "is not one of"),
        (["{logs}/walk.csv", "{logs}/short.csv", "--out", "{tmp}/out", "--trajectory", "p.tum"], "a single LOG"),
        (["{logs}/walk.csv", "--out", "{tmp}/out", "--scheduler", "there"], "an address such as tcp://"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(refused, logs, tmp_path, words, said):
    refused(["slam", *[word.format(logs=logs, tmp=tmp_path) for word in words]], said, tmp_path)


@pytest.mark.parametrize("name", ["slam", "merge"])
def test_the_graph_is_for_gtsam_where_that_is_asked_for(run, logs, place, tmp_path, name):
    files = [logs / "short.csv"] if name == "slam" else [place / "base.map", place / "target.map"]
    written = []
    for tangent in ("quaternion", "angle"):
        done = run(name, *files, "--g2o-rotation", tangent, "--out", tmp_path / tangent)
        assert done.code in {0, 3}, done.err
        lines = (tmp_path / tangent / "graph.g2o").read_text().splitlines()
        written.append(np.array([line.split()[10:] for line in lines if line.startswith("EDGE")], float))
    assert "--g2o-rotation angle" in (tmp_path / "angle" / "report.html").read_text()
    assert len(written[0]) > 0
    # Translation, then rotation: upper triangles by rows. Twice as long an error has a quarter of the information.
    scale = np.ones((6, 6))
    scale[:3, 3:], scale[3:, 3:] = 2, 4
    np.testing.assert_allclose(written[0], written[1] * scale[np.triu_indices(6)], rtol=1e-9)


def test_surveys_are_merged_and_a_folder_of_other_inputs_is_refused(run, refused, place, logs, tmp_path):
    words = ["merge", place / "base.csv", place / "target.map", "--out", tmp_path / "out"]
    done = run(*words)
    result = SlamResult.load(tmp_path / "out" / "result.json")
    assert done.code == (0 if result.is_connected else 3), done.err
    assert {log.name for log in result.logs} == {"base", "target"}
    assert (tmp_path / "out" / "report.html").is_file()
    direct = json.loads((place / "result.json").read_text())
    assert (done.code == 0) == (direct["status"] == "accepted")
    refused(["slam", logs / "walk.csv", "--out", tmp_path / "out"], "other inputs")


def test_what_slam_writes_beside_its_surveys_is_known(run, refused, corrected, tmp_path):
    walk = corrected / "walk.csv"
    for words, said in (
        (["merge", walk, corrected / "covariances.csv", "--out", tmp_path / "out"], "is a slam covariances file"),
        (["query", corrected / "result.json", walk, "--out", tmp_path / "x.csv"], "its map is map.map beside it"),
        (["localize", corrected / "map.map", corrected, "--out", tmp_path / "x.tum"], "is a folder, expected a file"),
        (["info", corrected], "is a folder, expected a file"),
    ):
        assert "register" not in refused(words, said)
    done = run("slam", corrected, "--out", tmp_path / "out")
    assert "1 logs; not read: covariances.csv" in done.err
    assert done.code == 0, done.err


def test_without_the_package_that_draws_all_but_the_report_is_written(run, logs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    done = run("slam", logs / "short.csv", "--out", tmp_path / "out")
    assert done.code == 3
    assert "no report.html" in done.err
    assert "viz" in done.err
    assert {"short.csv", "graph.g2o", "result.json"} <= {path.name for path in (tmp_path / "out").iterdir()}


@pytest.mark.parametrize("name", ["merge", "map"])
def test_one_file_of_poses_is_not_taken_for_several_surveys(name, refused, place, tmp_path):
    words = [name, place / "base.csv", place / "target.csv", "--trajectory", "p.tum", "--out", tmp_path / "out"]
    said = refused(words, "a single SURVEY", tmp_path)
    assert "magmatch convert SURVEY SURVEY_POSED.csv --trajectory POSES" in said


def test_fixed_points_give_their_frame_and_one_that_cannot_be_is_one_line(run, refused, logs, tmp_path, monkeypatch):
    walk, truth = mm.read_survey(logs / "short.csv"), np.load(logs / "truth.npy")
    points = tmp_path / "points.csv"
    rows = [f"short,{walk.times[k]},{p[0] + 50},{p[1]},{p[2]},0.02" for k in (3, 70, 140) for p in [truth[k]]]
    points.write_text("\n".join(["log,t,x,y,z,sd", *rows]))
    done = run("slam", logs / "short.csv", "--anchors", points, "--out", tmp_path / "out", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert [a["log"] for a in result["anchors"]] == ["short"] * 3
    assert result["logs"][0]["is_fixed"]
    assert "3 fixed points" in result["reason"]
    there = mm.Trajectory.load(tmp_path / "out" / "short.tum").positions
    assert np.abs(there[[3, 70, 140]] - truth[[3, 70, 140]] - [50, 0, 0]).max() < 0.1
    assert "Fixed points" in (tmp_path / "out" / "report.html").read_text()
    points.write_text("log,t,x,y,z,sd\nrobot,1,0,0,0,1\n")
    refused(["slam", logs / "short.csv", "--anchors", points, "--out", tmp_path / "no"], "name of a log")
    # Before any poses are worked out.
    monkeypatch.setattr("magmatch.preparation.odometry.open_walk.OpenedWalk.survey", None)
    points.write_text("log,t,lat,lon,z,sd\nshort,1,49,11,0,1\n")
    words = ["slam", logs / "short.csv", "--anchors", points, "--continue", "--out", tmp_path / "out"]
    refused(words, "points.csv, line 2: is in metres, ")
    assert {path.name for path in tmp_path.iterdir()} == {"out", "points.csv"}


def test_one_more_log_is_added_to_a_folder(run, refused, logs, corrected, tmp_path):
    shutil.copytree(corrected, tmp_path / "out")
    both = ["slam", logs / "walk.csv", logs / "short.csv", "--out", tmp_path / "out"]
    refused(both, "--continue")
    done = run(*both, "--continue")
    assert done.code == 0, done.err
    result = SlamResult.load(tmp_path / "out" / "result.json")
    assert [(log.name, log.component) for log in result.logs] == [("walk", 0), ("short", 0)]
    assert (tmp_path / "out" / "short.tum").is_file()
    refused([*both, "--continue", "--planar"], "--continue")
    refused(["slam", logs / "short.csv", "--out", tmp_path / "new", "--continue"], "no session")


def test_a_map_fixed_by_degrees_is_asked_in_degrees_and_keeps_its_origin(run, refused, logs, tmp_path):
    walk, truth = mm.read_survey(logs / "short.csv"), np.load(logs / "truth.npy").tolist()

    def in_degrees(row, latitude=49.0):
        # So many metres are a degree there.
        return f"{latitude + truth[row][1] / 111_220:.9f},{11 + truth[row][0] / 73_170:.9f}"

    for name, latitude in (("here", 49.0), ("there", 49.01)):
        rows = [f"short,{walk.times[k]},{in_degrees(k, latitude)},0,0.02" for k in (3, 70, 140)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["log,t,lat,lon,z,sd", *rows]))
        done = run("slam", logs / "short.csv", "--anchors", tmp_path / f"{name}.csv", "--out", tmp_path / name)
        assert done.code == 0, done.err
    here, frame = tmp_path / "here", mm.read_survey(tmp_path / "here" / "short.csv").frame
    assert frame.startswith("east, north, up of 49.0000")
    assert mm.FieldMap.load(here / "map.map").survey.frame == frame
    (tmp_path / "points.csv").write_text(f"lat,lon,z\n{in_degrees(70)},0\n")
    done = run("query", here / "map.map", tmp_path / "points.csv", "--out", tmp_path / "field.csv")
    assert done.code == 0, done.err
    found = np.genfromtxt(tmp_path / "field.csv", delimiter=",", names=True)
    np.testing.assert_allclose([found["x"], found["y"]], np.subtract(truth[70], truth[3])[:2], atol=0.05)
    floors = ["map", here / "short.csv", tmp_path / "there" / "short.csv", "--out", tmp_path / "both.map"]
    refused(floors, "expected surveys in one frame")
    refused(floors, "'origin: [49.")
    done = run("slam", logs / "short.csv", logs / "walk.csv", "--continue", "--out", here)
    assert done.code == 0, done.err
    assert mm.read_survey(here / "walk.csv").frame == frame


@pytest.mark.slow
def test_merge_in_other_processes_writes_the_same_closures(run, place, tmp_path):
    words = ["merge", place / "base.csv", place / "target.csv", "--json"]
    alone, both = (run(*words, "--out", tmp_path / out, *more) for out, *more in (["one"], ["two", "--jobs", "2"]))
    assert both.code == alone.code == 0, both.err
    assert json.loads(both.out)["closures"] == json.loads(alone.out)["closures"] != []
    assert not (tmp_path / ".two.unfinished").exists()


def test_a_log_of_another_place_is_said_to_be_tied_to_none(run, logs, tmp_path):
    drifting_walk(Place(9), 3, laps=0.7)[0].save(tmp_path / "far.csv")
    done = run("slam", logs / "short.csv", tmp_path / "far.csv", "--out", tmp_path / "out")
    assert done.code == 3, done.err
    assert "--no-gravity" not in done.err  # all poses are upright, at one height
    result = SlamResult.load(tmp_path / "out" / "result.json")
    assert [log.T_map_log for log in result.logs] == [None, None]
    assert (tmp_path / "out" / "map_2.map").is_file()
