# SPDX-License-Identifier: BSD-3-Clause
"""From a phone's export to a survey by the command line: odometry, then prepare; refusals in one line."""

import gzip
import json
import zipfile

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.cli.command import Layouts
from magmatch.cli.walks import read_walk
from magmatch.data.read import read_survey
from magmatch.data.trajectory import Trajectory

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
    pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
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
    (tmp_path / "quick.yaml").write_text("n_samples: 300\ndisturbances: {spikes: 'off', moving_metal: 'off'}\n")
    outcome = run(
        "prepare", export, "--trajectory", tmp_path / "walk.tum", "--out", tmp_path / "walk.csv",
        "--config", tmp_path / "quick.yaml",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    steps = [step["step"] for step in json.loads((tmp_path / "walk.json").read_text())["steps"]]
    assert steps[0] == "magnetometer"
    assert "readings taken:" in outcome.err
    assert len(read_survey(tmp_path / "walk.csv")) > 1000


def test_slam_takes_a_raw_log_as_with_poses_by_odometry(export, tmp_path, run):
    pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
    raw = run("slam", export, "--out", tmp_path / "raw")
    assert "Dead reckoning: " in raw.err
    run("odometry", export, "--out", tmp_path / "walk.tum")
    posed = run("slam", export, "--trajectory", tmp_path / "walk.tum", "--out", tmp_path / "posed")
    assert raw.code == posed.code
    assert raw.code in (0, 3)
    raw, posed = (Trajectory.load(tmp_path / name / "walk.tum") for name in ("raw", "posed"))
    moments = np.linspace(max(raw.times[0], posed.times[0]), min(raw.times[-1], posed.times[-1]), 50)
    at = [np.column_stack([np.interp(moments, t.times, x) for x in t.positions.T]) for t in (raw, posed)]
    np.testing.assert_allclose(*at, atol=0.05)


def test_info_names_the_sensors_and_says_where_poses_come_from(export, run):
    outcome = run("info", export)
    assert outcome.code == 0
    assert "Sensor Logger" in outcome.out
    for line in ("Magnetometer.csv  magnetometer  1200 messages, 50 Hz", "Gyroscope.csv  gyroscope"):
        assert line in outcome.out
    assert "magmatch odometry" in outcome.out
    mapped = run("map", export, "--out", export.parent / "walk.map")
    assert mapped.code == 2
    assert mapped.err.count("\n") == 1
    assert "--trajectory" in mapped.err


BAD = {
    "no phone's log": ("survey.csv", b"x,y,z,bx,by,bz\n1,2,3,4,5,6\n", "is a csv file, expected a phone's log"),
    "no gyroscope": ("log.txt", b"ACCE;0;0;0;0;9.8;3\nACCE;1;1;0;0;9.8;3\n", "expected readings of the gyroscope"),
    "a word for a number": ("log.txt", b"ACCE;0;0;0;up;9.8;3\n", "line 1, column 'y'"),
    "a damaged zip": ("walk.zip", b"PK\x03\x04" + bytes(60), "damaged zip"),
    "damaged gzip": ("log.txt.gz", gzip.compress(b"ACCE;0;0;0;0;9.8;3\n" * 99)[:-9], "damaged gzip"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_log_is_refused_in_one_line(case, tmp_path, run):
    name, content, words = BAD[case]
    (tmp_path / name).write_bytes(content)
    outcome = run("odometry", tmp_path / name, "--out", tmp_path / "out.tum")
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith(f"magmatch: {tmp_path / name}")
    assert words in outcome.err
    assert not (tmp_path / "out.tum").exists()


@pytest.mark.parametrize("words", [("--step-scale", "0"), ("--step-scale", "nan"), ("--speed", "1"), ()])
def test_bad_usage_is_refused(words, export, tmp_path, run):
    outcome = run("odometry", export, *(("--out", tmp_path / "x.tum") if words else ()), *words)
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1


def test_the_log_is_never_written_over(export, run):
    before = export.read_bytes()
    assert run("odometry", export, "--out", export).code == 2
    assert export.read_bytes() == before


def test_a_unit_of_length_is_none_of_dead_reckonings_metres(export):
    pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
    walks = [read_walk(export, Layouts(said)) for said in ({}, {("", "length_unit"): "mm"})]
    np.testing.assert_array_equal(walks[0].positions, walks[1].positions)
    assert np.ptp(walks[0].positions, axis=0).max() > 3


def test_a_walk_loses_no_sample_to_its_dead_reckoning_with_a_warning(export, tmp_path, run):
    pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
    assert run("odometry", export, "--out", tmp_path / "walk.tum").code == 0
    done = run("info", export, "--trajectory", tmp_path / "walk.tum")
    assert "without a pose" not in done.err
    assert len(read_walk(export, Layouts({}))) == len(readings()[0])
