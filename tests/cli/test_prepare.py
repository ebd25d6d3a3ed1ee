# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch prepare`` reads logs as they come, writes a survey and a report, and refuses in one line."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.read import read_survey
from magmatch.data.trajectory import Trajectory
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.corruption import Corruption, corrupt
from magmatch.simulation.simulate import simulate

HARD_IRON = np.array([12e-6, -20e-6, 15e-6])
QUICK = {"time_offset": {"mode": "off"}, "disturbances": {"spikes": "off", "moving_metal": "off"}}
OFF = QUICK | {
    "calibration": dict.fromkeys(("hard_iron", "soft_iron", "misalignment"), "off"),
    "currents": {"mode": "off"},
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Folder with log.csv (uT, sensor frame, a text and a number column more), poses.tum and quick.yaml."""
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    folder = tmp_path_factory.mktemp("logs")
    clean = simulate("office-hand-held", 3, SimulationConfig(n_samples=600, room_size=(1.5, 1.5, 0.5))).target
    Trajectory(clean.times, clean.positions, clean.orientations).save(folder / "poses.tum")
    raw, _ = corrupt(clean, Corruption(hard_iron=HARD_IRON), np.random.default_rng(0))
    readings = 1e6 * raw.orientations.apply(raw.field, inverse=True)
    rows = [
        f"{t!r},{b[0]!r},{b[1]!r},{b[2]!r},ok,{k % 7}"
        for k, (t, b) in enumerate(zip(raw.times.tolist(), readings.tolist(), strict=True))
    ]
    (folder / "log.csv").write_text("\n".join(["t,bx,by,bz,state,amps", *rows]) + "\n")
    (folder / "quick.yaml").write_text(json.dumps(QUICK))
    return folder


def words(logs, *more):
    return (
        "prepare", logs / "log.csv", "--field-unit", "uT", "--field-frame", "sensor", "--trajectory",
        logs / "poses.tum", "--config", logs / "quick.yaml", *more,
    )  # fmt: skip


def test_a_raw_log_becomes_a_survey_with_a_report_beside_it(logs, run, tmp_path):
    outcome = run(*words(logs, "--out", tmp_path / "s.csv"))
    assert outcome.code == 0, outcome.err
    report = json.loads((tmp_path / "s.json").read_text())
    assert report["schema"] == "magmatch.preparation/1"
    steps = {step["step"]: step for step in report["steps"]}
    np.testing.assert_allclose(steps["hard iron"]["figures"]["hard_iron"], HARD_IRON, rtol=0, atol=0.5e-6)
    assert steps["channel amps"]["outcome"] == "unchanged"
    assert "hard iron" in outcome.err
    assert "applied" in outcome.err
    assert len(read_survey(tmp_path / "s.csv")) == report["n_samples"][1]
    known = run(*words(logs, "--out", tmp_path / "t.csv", "--sensor-from", tmp_path / "s.json"))
    assert known.code == 0
    np.testing.assert_allclose(
        read_survey(tmp_path / "t.csv").field, read_survey(tmp_path / "s.csv").field, rtol=0, atol=0.3e-6
    )


def test_a_sensor_turned_about_is_a_known_one(logs, run, tmp_path):
    rng = np.random.default_rng(1)
    readings = 1e6 * (Rotation.random(200, rng=rng).apply([2e-5, 0, -4e-5]) + HARD_IRON)
    np.savetxt(tmp_path / "turned.csv", readings, delimiter=",", header="bx,by,bz", comments="")
    (tmp_path / "off.yaml").write_text(json.dumps(OFF))
    more = ("--out", tmp_path / "s.csv", "--sensor-from", tmp_path / "turned.csv", "--config", tmp_path / "off.yaml")
    assert run(*words(logs, *more)).code == 0
    sensor = json.loads((tmp_path / "s.json").read_text())["sensor"]
    np.testing.assert_allclose(sensor["shift"], HARD_IRON, rtol=0, atol=1e-9)


# A sensor turned about the vertical only; numbers in another unit; one at the end of its range.
@pytest.mark.parametrize(
    ("change", "code", "words_said"),
    [
        (lambda level, every: level, 0, "z not separable from the place's own field"),
        (lambda level, every: every, 0, "turned.csv: hard iron x +"),
        (lambda level, every: 10 * every, 0, "use --field-unit mG"),
        (lambda level, every: 1e-6 * every, 2, "use --field-unit T"),
        (lambda level, every: np.minimum(every, 30), 0, "z component is at the end of its range, 30 uT"),
    ],
)
def test_what_a_turned_sensor_does_not_tell_is_said(change, code, words_said, logs, run, tmp_path):
    rng = np.random.default_rng(1)
    turns = Rotation.from_euler("z", rng.uniform(0, 360, (500, 1)), degrees=True), Rotation.random(500, rng=rng)
    level, every = (1e6 * (turn.apply([2e-5, 0, -4e-5]) + HARD_IRON) + rng.normal(0, 0.3, (500, 3)) for turn in turns)
    np.savetxt(tmp_path / "turned.csv", change(level, every), delimiter=",", header="bx,by,bz", comments="")
    (tmp_path / "off.yaml").write_text(json.dumps(OFF))
    more = ("--out", tmp_path / "s.csv", "--sensor-from", tmp_path / "turned.csv", "--config", tmp_path / "off.yaml")
    outcome = run(*words(logs, *more))
    assert outcome.code == code
    assert words_said in " ".join(outcome.err.split())


def write_log(path, survey, amps):
    """Field and poses of a survey as MCAP, with a topic of a current beside them."""
    from mcap.writer import Writer

    def head(stamp, frame):
        raw = b"\0\1\0\0" + struct.pack("<iII", *divmod(stamp, 10**9), len(frame) + 1) + frame + b"\0"
        return raw + bytes(-(len(raw) - 4) % 8)

    types = {"/mag": "sensor_msgs/msg/MagneticField", "/pose": "geometry_msgs/msg/PoseStamped",
             "/wheels/amps": "std_msgs/msg/Float64"}  # fmt: skip
    readings = survey.orientations.apply(survey.field, inverse=True)
    poses = np.hstack([survey.positions, survey.orientations.as_quat()])
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        ids = {
            topic: writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            for topic, kind in types.items()
        }
        for i, t in enumerate(survey.times.tolist()):
            stamp = 10**15 + round(t * 1e9)
            for topic, payload in {
                "/mag": head(stamp, b"mag") + readings[i].tobytes() + bytes(72),
                "/pose": head(stamp, b"map") + poses[i].tobytes(),
                "/wheels/amps": b"\0\1\0\0" + struct.pack("<d", amps[i]),
            }.items():
                writer.add_message(ids[topic], stamp, payload, stamp)
        writer.finish()


@pytest.mark.parametrize("amplitude", [0.0, 2e-6])
def test_a_current_of_a_bag_is_flagged_where_the_field_follows_it(amplitude, run, tmp_path):
    pytest.importorskip("mcap")
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    clean = simulate("office-hand-held", 3, SimulationConfig(n_samples=600, room_size=(1.5, 1.5, 0.5))).target
    amps = 5.0 + np.sign(np.sin(1.7 * np.arange(len(clean))))
    field = clean.field + clean.orientations.apply(np.outer(amps - 5.0, [amplitude, 0.0, 0.0]))
    write_log(tmp_path / "log.mcap", replace(clean, field=field), amps)
    (tmp_path / "quick.yaml").write_text(json.dumps(QUICK))
    outcome = run("prepare", tmp_path / "log.mcap", "--out", tmp_path / "s.csv", "--config", tmp_path / "quick.yaml")
    assert outcome.code == 0, outcome.err
    steps = {step["step"]: step for step in json.loads((tmp_path / "s.json").read_text())["steps"]}
    found = steps["channel /wheels/amps"]
    assert found["outcome"] == ("flagged" if amplitude else "unchanged")
    np.testing.assert_allclose(found["figures"]["estimate"], [amplitude, 0, 0], rtol=0, atol=2e-7)


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (["--place", "48,11,500"], "--date"),
        (["--date", "2024-05-01"], "--place"),
        (["--place", "48;11", "--date", "2024-05-01"], "LAT,LON,HEIGHT"),
        (["--place", "98,11,500", "--date", "2024-05-01"], "latitude"),
        (["--place", "48,11,500", "--date", "May"], "YYYY-MM-DD"),
        (["--config", "wrong.yaml"], "did you mean 'hard_iron'"),
        (["--config", "high.yaml"], "time_offset.largest"),
        (["--sensor-from", "other.json"], "magmatch.preparation/1"),
        (["--sensor-from", "few.csv"], "at least 50 different readings"),
    ],
)
def test_mistakes_are_one_line_and_code_2(more, expected, logs, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("wrong.yaml").write_text("calibration: {hard_irn: on}\n")
    Path("high.yaml").write_text("time_offset: {largest: 1e9}\n")
    Path("other.json").write_text('{"schema": "magmatch.registration/1"}')
    Path("few.csv").write_text("bx,by,bz\n1,2,3\n")
    refused(words(logs, "--out", "s.csv", *more), expected)
    assert not Path("s.csv").exists()


def test_a_pipe_gets_the_survey_and_no_report_beside_it(logs, run):
    (logs / "off.yaml").write_text(json.dumps(OFF))
    outcome = run(*words(logs, "--out", "/dev/stdout", "--config", logs / "off.yaml"))
    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith("t,x,y,z,bx,by,bz,")
    assert not Path("/dev/stdout.json").exists()


@pytest.mark.parametrize("place", ["", ".", "/"])
def test_a_folder_without_a_name_is_no_name_of_a_survey(place, logs, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(words(logs, "--out", place), "is a folder, expected the name of a file to write")
