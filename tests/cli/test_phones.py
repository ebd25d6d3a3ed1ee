# SPDX-License-Identifier: BSD-3-Clause
"""From a phone's export to a survey by the command line: odometry, then prepare; refusals in one line."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magmatch as mm
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError
from magmatch.preparation.odometry.open_walk import open_walk
from magmatch.preparation.prepare import prepare_either
from magmatch.slam.session import Session

pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
pytestmark = pytest.mark.usefixtures("numbers_are_given")
G, RATE = 9.81, 50.0


def readings(seconds=24.0):
    """Times, and what a phone reads that is carried to and fro and turned about; the field is smooth."""
    t = np.arange(0, seconds, 1 / RATE)
    walking = t > 4
    heading = np.where(walking, np.pi * np.clip(np.floor((t - 4) / 5), 0, 3) + 0.3 * np.sin(t), 0)
    heading = np.convolve(np.pad(heading, 25, "edge"), np.ones(51) / 51, "valid")
    R = Rotation.from_euler("zx", np.column_stack([heading, np.full(len(t), 0.6)]))
    up = G + 2.5 * walking * np.sin(2 * np.pi * 1.8 * t)
    felt = R.apply(np.outer(up, [0, 0, 1]), inverse=True)
    spin = (R[:-1].inv() * R[1:]).as_rotvec() * RATE
    field = R.apply([18, 3, -45] + 3 * np.sin(t)[:, None] * [1, 0.5, 0.2], inverse=True)
    return t, {"TotalAcceleration": felt, "Gyroscope": np.vstack([spin, spin[-1:]]), "Magnetometer": field}


def table(t, values):
    lines = [
        f"{1_700_000_000_000_000_000 + round(1e9 * s)},{s},{x},{y},{z}"
        for s, (x, y, z) in zip(t, values, strict=True)
    ]
    return "\n".join(["time,seconds_elapsed,x,y,z", *lines, ""])


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """walk.zip of Sensor Logger, with raw readings of the magnetometer too."""
    path = tmp_path_factory.mktemp("phone") / "walk.zip"
    t, sensors = readings()
    sensors["MagnetometerUncalibrated"] = sensors["Magnetometer"] + [90, -60, 120]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in sensors.items():
            archive.writestr(f"{name}.csv", table(t, values))
    return path


def test_odometry_then_prepare_makes_a_survey(export, tmp_path, run):
    outcome = run("odometry", export, "--out", tmp_path / "walk.tum")
    assert (outcome.code, outcome.out) == (0, "")
    assert "steps in 24 s" in outcome.err
    poses = Trajectory.load(tmp_path / "walk.tum")
    assert not poses.positions[0].any()
    assert not poses.positions[:, 2].any()
    scaled = run("odometry", export, "--out", tmp_path / "long.tum", "--step-scale", "1.1")
    assert scaled.code == 0
    longer = Trajectory.load(tmp_path / "long.tum").positions
    np.testing.assert_allclose(longer, 1.1 * poses.positions, atol=1e-9)
    quick = {
        "calibration": dict.fromkeys(("hard_iron", "soft_iron", "misalignment"), "off"),
        "time_offset": {"mode": "off"},
        "disturbances": {"spikes": "off", "moving_metal": "off"},
    }
    (tmp_path / "quick.yaml").write_text(json.dumps(quick))
    outcome = run(
        "prepare", export, "--trajectory", tmp_path / "walk.tum", "--out", tmp_path / "walk.csv",
        "--config", tmp_path / "quick.yaml",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    steps = [step["step"] for step in json.loads((tmp_path / "walk.json").read_text())["steps"]]
    assert steps[0] == "magnetometer"
    assert "readings taken:" in outcome.err
    assert len(read_survey(tmp_path / "walk.csv")) > 1000


def read_walk(path, layout=None):
    return open_walk(path, layout, with_points=False).survey()


def xyz10(folder, name, origin=(100.0, 50.0)):
    """A walk as XYZ10's app writes it, with a waypoint of the plan at each turn: from east to west and back."""
    t, sensors = readings()
    start, tags = 1_574_568_614_840, {"TotalAcceleration": "ACCELEROMETER", "Gyroscope": "GYROSCOPE"}
    tags["Magnetometer"] = "MAGNETIC_FIELD"
    lines = ["#\tstartTime:1574568614708"]
    for sensor, tag in tags.items():
        # A sixth of the magnetometer's readings is as much as slam needs here.
        every = 6 if sensor == "Magnetometer" else 1
        for s, v in zip(t[::every], sensors[sensor][::every], strict=True):
            lines.append("\t".join(map(str, [start + round(1e3 * s), f"TYPE_{tag}", *v, 3])))
    # Steps go along the phone's upper end: y at first; turns of a half at 9 s and 14 s.
    for s, along in ((-0.14, 0.0), (9.0, 5.5), (14.0, 0.0), (19.0, 5.5)):
        x, y = origin
        lines.append(f"{start + round(1e3 * s)}\tTYPE_WAYPOINT\t{x + along}\t{y}")
    folder.mkdir(exist_ok=True)
    (folder / name).write_text("\n".join([*lines, ""]))
    return folder / name


@pytest.mark.parametrize("scale", ["0", "nan"])
def test_a_scale_of_steps_that_cannot_be_is_refused(scale, export, tmp_path, refused):
    refused(["odometry", export, "--out", tmp_path / "x.tum", "--step-scale", scale], "--step-scale", tmp_path)


def test_a_folder_of_logs_with_waypoints_gets_the_frame_of_their_plan(tmp_path, run):
    xyz10(tmp_path / "floor", "one.txt")
    xyz10(tmp_path / "floor", "two.txt", origin=(100.0, 80.0))
    two = tmp_path / "floor" / "two.txt"
    two.write_text(two.read_text().replace("\t18.", "\t19."))  # no log is given twice
    (tmp_path / "floor" / "floor_info.json").write_text("{}")
    outcome = run("slam", tmp_path / "floor", "--out", tmp_path / "out", "--json")
    assert outcome.code == 0, outcome.err
    assert "2 logs; not read: floor_info.json" in outcome.err
    assert "Dead reckoning of two.txt: " in outcome.err
    assert "8 surveyed points that logs hold are fixed points (--no-waypoints" in outcome.err
    assert "Fixed points: passed 0." in outcome.err
    result = json.loads(outcome.out)
    assert [(log["name"], log["component"], log["is_fixed"]) for log in result["logs"]] == [
        ("one", 0, True),
        ("two", 0, True),
    ]
    assert [a["log"] for a in result["anchors"]] == ["one"] * 4 + ["two"] * 4
    for name, y in (("one", 50.0), ("two", 80.0)):
        poses = Trajectory.load(tmp_path / "out" / f"{name}.tum")
        at = np.interp(1_574_568_614.840 + 9.0, poses.times, np.arange(len(poses.times))).round().astype(int)
        assert np.abs(poses.positions[at, :2] - [105.5, y]).max() < 0.6


def test_without_waypoints_none_is_used(tmp_path, run, monkeypatch):

    def asked(*_args, waypoints, **_named):
        raise DataFormatError("walk.txt", f"waypoints: {waypoints}")

    monkeypatch.setattr(Session, "add_logs", asked)
    words = ("slam", xyz10(tmp_path, "walk.txt"), "--out", tmp_path / "out")
    assert "waypoints: True" in run(*words).err
    assert "waypoints: False" in run(*words, "--no-waypoints").err


def test_localization_reads_no_surveyed_point(tmp_path):
    log = xyz10(tmp_path / "floor", "walk.txt")
    known = read_walk(log)
    log.write_text("".join(line for line in log.read_text().splitlines(keepends=True) if "WAYPOINT" not in line))
    np.testing.assert_array_equal(read_walk(log).positions, known.positions)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("walk,1574568613,0,0,0,0.1", "points.csv, line 3: expected a time between"),
        ("talk,1574568620,0,0,0,0.1", "points.csv, line 3: expected the name of a log (walk)"),
        ("walk,1574568620,0,zero,0,0.1", "points.csv, line 3, column 'y'"),
    ],
)
def test_tables_are_checked_before_a_log_is_dead_reckoned(row, said, tmp_path, refused, monkeypatch):
    monkeypatch.setattr("magmatch.preparation.odometry.open_walk.dead_reckon", lambda _: pytest.fail("too soon"))
    log = xyz10(tmp_path, "walk.txt")
    points = tmp_path / "points.csv"
    points.write_text(f"log,t,x,y,z,sd\nwalk,1574568614.1,0,0,0,0.1\n{row}\n")
    refused(["slam", log, "--anchors", points, "--out", tmp_path / "out"], said)


AT_ONCE = [f"{x},{y},0,2e-5,0,{z}e-5\n" for x, y, z in np.random.default_rng(0).uniform(1, 30, (200, 3)).round(3)]
ALSO_READ = {
    "a log without a gyroscope": ("log.txt", "ACCE;0;0;0;0;9.8;3\nACCE;1;1;0;0;9.8;3\n", "expected readings of the"),
    "a log that is too short": ("log.txt", "ACCE;0;0;0;0;9.8;3\nGYRO;0;0;0;0;0;3\n" * 2, "expected a walk of 2 s"),
    "points at once": ("log.csv", f"x,y,z,bx,by,bz\n{''.join(AT_ONCE)}", "log.csv: its samples follow no path"),
    "other settings": ("other.yaml", "{loops: 3}", "loops"),
    "a folder of something else": ("out/notes.txt", "", "out: is not empty"),
    "a damaged result": ("out/result.json", "{", "result.json"),
    "poses without orientations": ("poses.tum", "0 1 2\n", "poses.tum, line 1"),
}


@pytest.mark.parametrize("case", ALSO_READ)
def test_whatever_else_is_read_is_checked_before_a_log_is_dead_reckoned(case, tmp_path, refused, monkeypatch):
    monkeypatch.setattr("magmatch.preparation.odometry.open_walk.dead_reckon", lambda _: pytest.fail("too soon"))
    name, content, said = ALSO_READ[case]
    (tmp_path / "out").mkdir()
    other = tmp_path / name
    other.write_text(content)
    more = {".yaml": ["--config", other], ".tum": ["--trajectory", other]}.get(other.suffix, [])
    logs = [xyz10(tmp_path, "walk.txt"), *([other] if other.stem == "log" else [])]
    refused(["slam", *logs, *more, "--out", tmp_path / "out"], said)


def test_points_in_degrees_are_metres_about_the_first(tmp_path, run):
    t, sensors = readings()
    lines = ["% GetSensorData"]
    for tag, name in (("ACCE", "TotalAcceleration"), ("GYRO", "Gyroscope"), ("MAGN", "Magnetometer")):
        every = 6 if tag == "MAGN" else 1
        rows = zip(t[::every], sensors[name][::every], strict=True)
        lines += [f"{tag};{s};{s};{x};{y};{z};3" for s, (x, y, z) in rows]
    north = 1 / 111_200  # degrees a metre
    lines += [f"POSI;{s};1;{49 + north * m};11;0;1" for s, m in ((0, 0.0), (9, 5.5), (14, 0.0), (19, 5.5))]
    (tmp_path / "walk.txt").write_text("\n".join(lines))
    outcome = run("slam", tmp_path / "walk.txt", "--out", tmp_path / "out", "--json")
    assert outcome.code == 0, outcome.err
    result = json.loads(outcome.out)
    assert result["config"]["origin"] == [49, 11]
    assert "metres east and north of 49.0,11.0\n" in outcome.err
    assert [round(a["position"][1], 1) for a in result["anchors"]] == [0, 5.5, 0, 5.5]


def test_info_names_the_sensors_and_says_where_poses_come_from(export, run, refused):
    outcome = run("info", export)
    assert outcome.code == 0
    assert "Sensor Logger" in outcome.out
    for line in ("Magnetometer.csv  magnetometer  1200 messages, 50 Hz", "Gyroscope.csv  gyroscope"):
        assert line in outcome.out
    assert "magmatch odometry" in outcome.out
    refused(["map", export, "--out", export.parent / "walk.map"], "--trajectory")


def test_what_is_no_phones_log_is_refused_in_one_line(tmp_path, refused):
    (tmp_path / "survey.csv").write_text("x,y,z,bx,by,bz\n1,2,3,4,5,6\n")
    words = ["odometry", tmp_path / "survey.csv", "--out", tmp_path / "out.tum"]
    said = refused(words, "is a csv file, expected a phone's log")
    assert said.startswith(f"magmatch: {tmp_path / 'survey.csv'}")
    assert not (tmp_path / "out.tum").exists()


def test_a_unit_of_length_is_none_of_dead_reckonings_metres(export):
    walks = [read_walk(export, layout) for layout in (None, SurveyFormat(length_unit="mm"))]
    np.testing.assert_array_equal(walks[0].positions, walks[1].positions)
    assert np.ptp(walks[0].positions, axis=0).max() > 3


def test_a_walk_loses_no_sample_to_its_dead_reckoning_with_a_warning(export, tmp_path, run):
    assert run("odometry", export, "--out", tmp_path / "walk.tum").code == 0
    done = run("info", export, "--trajectory", tmp_path / "walk.tum")
    assert "without a pose" not in done.err
    assert len(read_walk(export)) == len(readings()[0])


def featureless_room():
    """A map in which nothing is searched, since its field tells no places apart."""
    numbers = mm.FieldConfig(prior="spline", lengthscale=1.0, signal_sd=5e-6, noise_sd=1e-7, spacing=0.5)
    return mm.build_map(mm.Survey(np.random.default_rng(0).uniform(0, 2, (40, 3)), np.full((40, 3), 2e-5)), numbers)


@pytest.mark.parametrize(
    ("words", "stated", "expected"),
    [
        ([], {}, [0.5, 6.0]),
        ([], {"odometry": {"turn_share": 0.4}}, [0.5, 6.0]),
        ([], {"odometry": {"sd": [0.15, 2.0]}}, [0.15, 2.0]),
        (["--odometry-sd", "0.15,2"], {}, [0.15, 2.0]),
    ],
)
def test_both_doors_take_the_same_drift_of_a_dead_reckoned_log(words, stated, expected, export, tmp_path, run):
    room, walk = featureless_room(), read_walk(export)
    room.save(tmp_path / "room.map")
    (tmp_path / "settings.yaml").write_text(json.dumps(stated))
    asked = [*words, "--out", tmp_path / "where.tum", "--config", tmp_path / "settings.yaml", "--json"]
    told = json.loads(run("localize", tmp_path / "room.map", export, *asked).out)
    assert told["config"]["odometry"]["sd"] == expected
    if not words:
        track = mm.localize(room, walk, mm.LocalizerConfig(**stated))
        assert track.result().to_dict()["config"] == told["config"]


def test_poses_of_a_file_of_their_own_are_not_dead_reckoned(export, tmp_path, run):
    run("odometry", export, "--out", tmp_path / "walk.tum")
    walk = read_walk(export, SurveyFormat(trajectory=tmp_path / "walk.tum"))
    assert not walk.is_dead_reckoned
    track = mm.localize(featureless_room(), walk, live=True)
    assert track.config.odometry.sd == (0.15, 2.0)


def test_a_log_without_magnetometer_is_told_which_sensors_it_has(export, tmp_path):
    with zipfile.ZipFile(export) as whole, zipfile.ZipFile(tmp_path / "walk.zip", "w") as part:
        for name in ("TotalAcceleration.csv", "Gyroscope.csv"):
            part.writestr(name, whole.read(name))
    with pytest.raises(DataFormatError, match="of the magnetometer for a survey; found sensors: gyroscope, accelero"):
        open_walk(tmp_path / "walk.zip")


def said_of(folder, offsets, caplog):
    """What is said of the size of the field of a log whose magnetometers have these offsets, uT."""
    t, sensors = readings()
    own = sensors.pop("Magnetometer")
    with zipfile.ZipFile(folder / "walk.zip", "w") as archive:
        for name, values in (sensors | {name: own + offset for name, offset in offsets.items()}).items():
            archive.writestr(f"{name}.csv", table(t, values))
    caplog.clear()
    read_walk(folder / "walk.zip")
    return [m for m in caplog.messages if "calibration" in m or "magnitude" in m]


def test_the_unit_of_a_phones_field_is_known_and_its_offset_said_once(tmp_path, caplog):
    (said,) = said_of(tmp_path, {"MagnetometerUncalibrated": [200, -150, 300]}, caplog)
    assert "read without the phone's own calibration; expect an offset ('magmatch prepare'): the median field" in said
    assert said_of(tmp_path, {"MagnetometerUncalibrated": [200, -150, 300], "Magnetometer": 0}, caplog) == []
    (said,) = said_of(tmp_path, {"Magnetometer": [200, -150, 300]}, caplog)
    assert said.endswith("unusual on Earth (about 50 uT): a magnet, or an offset of the sensor ('magmatch prepare')?")


def test_preparing_the_phones_own_readings_says_nothing_of_the_raw_ones_size(caplog):
    t = np.arange(400) / 10
    p = np.column_stack([t, np.sin(t), np.zeros(400)])
    own = mm.Survey(p, 1e-6 * (np.array([18, 3, -45]) + np.sin(p)), t, Rotation.from_euler("z", t[:, None]))
    raw = replace(own, field=own.field + own.orientations.apply([2e-4, -1e-4, 2e-4]))
    quick = {"time_offset": {"mode": "off"}, "disturbances": {"spikes": "off", "moving_metal": "off"}}
    prepare_either(own, raw, mm.PreparationConfig(**quick))
    assert not [m for m in caplog.messages if "magnitude" in m]
