# SPDX-License-Identifier: BSD-3-Clause
"""Options for reading reach every file that their help names, in every command, and no other."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch.data.read
from magmatch.cli.added import ELSEWHERE
from magmatch.cli.main import build_app
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError

N = 40
RNG = np.random.default_rng(2)
TIMES = 1_700_000_000 + 0.25 * np.arange(N)
POSITIONS, FIELD = RNG.normal(0, 2, (N, 3)), 1e-6 * RNG.normal([18, 3, -45], 4, (N, 3))
TURNS = Rotation.from_rotvec(RNG.normal(0, 1, (N, 3)))
MOUNT = RigidTransform.from_components([0.1, 0.0, 0.2], Rotation.from_quat([0, 0, 0.6, 0.8]))
ODD = [
    "--field-unit", "uT", "--length-unit", "mm", "--time-unit", "ms", "--field-frame", "sensor", "--recover",
    "--columns", "t=stamp,x=px,y=py,z=pz,bx=mx,by=my,bz=mz", "--extrinsic", "0.1 0 0.2 0 0 0.6 0.8",
    "--pose-sd", "0.05",
]  # fmt: skip
# What each command is called with where it reads A, or A and B; "{out}" is a new name.
ONE = {
    "info": ["A"], "convert": ["A", "{out}.csv"], "prepare": ["A", "--out", "{out}.csv"],
    "transform": ["A", "--by", "result", "--out", "{out}.csv"],
    "localize": ["some.map", "A", "--out", "{out}.tum"], "slam": ["A", "--out", "{out}"],
    "map": ["A", "--out", "{out}.map"], "view": ["A", "--out", "{out}.html"],
}  # fmt: skip
TWO = {
    "register": ["A", "B"], "merge": ["A", "B", "--out", "{out}"], "slam": ["A", "B", "--out", "{out}"],
    "map": ["A", "B", "--out", "{out}.map"], "view": ["A", "B", "--out", "{out}.html"],
}  # fmt: skip


def rows(*columns):
    return "".join(",".join(map(repr, row)) + "\n" for row in np.column_stack(columns).tolist())


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Files of one survey: plain in SI, odd, and a field with its poses in a file of their own."""
    monkeypatch.chdir(tmp_path)
    plain = (TIMES, POSITIONS, TURNS.as_quat(), TURNS.apply(FIELD))
    (tmp_path / "plain.csv").write_text("t,x,y,z,qx,qy,qz,qw,bx,by,bz\n" + rows(*plain))
    head = "stamp,px,py,pz,qx,qy,qz,qw,mx,my,mz\n"
    odd = rows(1e3 * TIMES, 1e3 * POSITIONS, TURNS.as_quat(), 1e6 * FIELD)
    for name in ("odd.csv", "odd2.csv"):
        (tmp_path / name).write_text(head + odd + "1,2,lost\n")
    (tmp_path / "field.csv").write_text("stamp,mx,my,mz\n" + rows(1e3 * TIMES, 1e6 * FIELD))
    poses = rows(1e6 * TIMES, 1e3 * POSITIONS, TURNS.as_quat()).replace(",", " ")
    (tmp_path / "poses.tum").write_text(poses + "1 2 lost")
    return tmp_path


@pytest.fixture
def read(run, files, monkeypatch):
    """Run a command up to where it has read its surveys; gives them by the names of their files."""
    plain, found = magmatch.data.read.read_as_written, {}
    accepted = SimpleNamespace(T_base_target=RigidTransform.identity())
    monkeypatch.setattr("magmatch.cli.commands.transform.read_result", lambda _: accepted)

    def call(command, words, options, **names):
        def recorded(path, layout):
            found[str(path)], used = plain(path, layout)
            if len(found) == len(names):
                raise DataFormatError(path, "is read, and that is enough")
            return found[str(path)], used

        monkeypatch.setattr(magmatch.data.read, "read_as_written", recorded)
        words = [names.get(word, word.format(out=files / "new")) for word in words]
        done = run(command, *words, *options)
        assert "enough" in done.err or "is read, and" in done.out, done
        return found

    return call


def require(command):
    pytest.importorskip({"view": "plotly"}.get(command, "numpy"))


def is_carried(survey, mount=MOUNT):
    """The survey in SI, of the sensor."""
    np.testing.assert_allclose(survey.times, TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(survey.positions, POSITIONS + TURNS.apply(mount.translation), atol=1e-9)
    np.testing.assert_allclose(survey.field, (TURNS * mount.rotation).apply(FIELD), atol=1e-15)


def commands():
    """Every command of the package that has options for reading, with those options by name."""
    group = typer.main.get_command(build_app())
    for name, command in group.commands.items():
        options = {p.opts[0]: p for p in command.params if p.opts[0].startswith("--")}
        if "--field-unit" in options and name not in ELSEWHERE:
            yield name, options


def test_all_commands_that_read_surveys_are_tried_here():
    assert {name for name, _ in commands()} == {*ONE, *TWO}


def test_help_says_of_which_file_each_option_is():
    flags = ["--" + name.replace("_", "-") for name in SurveyFormat.model_fields]
    for name, options in commands():
        arguments = (*ONE.get(name, ()), *TWO.get(name, ()))
        for flag in flags:
            files, colon, rest = options[flag].help.partition(": ")
            assert colon, (name, flag)
            assert rest
            assert set(files.split()) & {"INPUT", "FILE", "LOG", "SURVEY", "BASE", "TARGET"}, (name, flag)
            assert ("every" in files or " and " in files) == ("B" in arguments), (name, flag)
        for side in ("base", "target"):
            if f"--{side}-field-unit" in options:
                assert all(options[f"--{side}{flag[1:]}"].hidden for flag in flags)


@pytest.mark.parametrize("command", ONE)
def test_options_reach_the_file(command, read):
    require(command)
    found = read(command, ONE[command], ODD, A="odd.csv")
    is_carried(found["odd.csv"])
    if command != "info":
        assert found["odd.csv"].pose_sd == 0.05


@pytest.mark.parametrize("command", TWO)
def test_options_reach_both_files(command, read):
    require(command)
    found = read(command, TWO[command], ODD, A="odd.csv", B="odd2.csv")
    for survey in found.values():
        is_carried(survey)


@pytest.mark.parametrize("side", ["base", "target"])
@pytest.mark.parametrize("command", ["register", "view"])
def test_options_of_one_survey_reach_that_one_only(command, side, read, monkeypatch):
    require(command)
    words = TWO[command]
    if command == "view":
        words = ["result.json", *words]
        plain = sys.modules["magmatch.data.formats.sniff"].sniff
        kinds = {"result.json": "registration"}
        monkeypatch.setattr("magmatch.data.formats.sniff.sniff", lambda path: kinds.get(str(path)) or plain(path))
    odd = [f"--{side}-{word[2:]}" if word.startswith("--") else word for word in ODD]
    names = {"A": "odd.csv", "B": "plain.csv"} if side == "base" else {"A": "plain.csv", "B": "odd.csv"}
    found = read(command, words, odd, **names)
    is_carried(found["odd.csv"])
    is_carried(found["plain.csv"], RigidTransform.identity())


def test_options_of_base_and_target_need_a_result_to_view(run, files):
    pytest.importorskip("plotly")
    done = run("view", "plain.csv", "--target-field-unit", "uT")
    assert done.code == 2
    assert "--target-field-unit: expected a registration result" in done.err


@pytest.mark.parametrize("command", ONE)
def test_options_reach_the_trajectory_and_each_file_has_its_own_clock(command, read):
    require(command)
    options = [word for word in ODD if word not in {"--pose-sd", "0.05"}]
    options += ["--trajectory", "poses.tum", "--trajectory-time-unit", "us"]
    options[options.index("--columns") + 1] = "t=stamp,bx=mx,by=my,bz=mz"
    is_carried(read(command, ONE[command], options, A="field.csv")["field.csv"])


def test_a_trajectory_that_is_the_file_itself_has_the_units_of_the_file(run, files):
    options = ["--time-unit", "us", "--length-unit", "mm", "--recover"]
    assert run("convert", "poses.tum", "out.tum", *options).code == 0
    np.testing.assert_allclose(Trajectory.load("out.tum").positions, POSITIONS, atol=1e-12)
    np.testing.assert_allclose(Trajectory.load("out.tum").times, TIMES, rtol=0, atol=1e-6)
    done = run("info", "poses.tum", *options)
    assert f"time first {TIMES[0]:.3f} s" in " ".join(done.out.split())


def test_options_reach_the_recording_of_a_turned_sensor(files):
    from magmatch.cli.commands.prepare import read_sensor

    turned = Rotation.random(60, rng=RNG).apply([20.0, 0, 45]) * [1.02, 0.97, 1] + [3, -2, 1]
    (files / "plain_turn.csv").write_text("bx,by,bz\n" + rows(1e-6 * turned))
    (files / "odd_turn.csv").write_text("mx,my,mz\n" + rows(turned) + "1,lost\n")
    expected = read_sensor(files / "plain_turn.csv", SurveyFormat())
    layout = SurveyFormat(field_unit="uT", columns="bx=mx,by=my,bz=mz", recover=True)
    found = read_sensor(files / "odd_turn.csv", layout)
    np.testing.assert_allclose(found.shift, expected.shift, rtol=1e-6)
