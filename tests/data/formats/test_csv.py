# SPDX-License-Identifier: BSD-3-Clause
"""The survey CSV: what is unambiguous is read, units and frames are settled once, saving loses nothing."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from magmatch.data.formats.csv import read_points, read_survey_csv
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.data.units import METRE_PER_UNIT, TESLA_PER_UNIT
from magmatch.errors import DataFormatError

NUMBERS = np.column_stack([np.arange(12), np.arange(12) ** 2, np.arange(12) % 3, np.full((12, 3), 2e-5)]).astype(
    float
)
LINES = [",".join(map(repr, row)) for row in NUMBERS.tolist()]
PLAIN = "\n".join(["x,y,z,bx,by,bz", *LINES, ""])
REVERSED = "\n".join(["bz,by,bx,z,y,x", *(",".join(line.split(",")[::-1]) for line in LINES)])

SAME_CONTENT = {
    "plain": PLAIN,
    "CR LF": PLAIN.replace("\n", "\r\n"),
    "old Mac line ends": PLAIN.replace("\n", "\r"),
    "no newline at the end": PLAIN.rstrip("\n"),
    "byte order mark": "\ufeff" + PLAIN,
    "UTF-16": PLAIN.encode("utf-16"),
    "columns in another order": REVERSED,
    "capitals": PLAIN.replace("x,y,z,bx,by,bz", "X,Y,Z,Bx,By,Bz"),
    "blanks around cells": PLAIN.replace(",", " , "),
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "white space": PLAIN.replace(",", "   "),
    "indented white space": PLAIN.replace(",", "   ").replace("\n", " \n  "),
    "comments and blank lines": "# made by hand\n\n" + PLAIN.replace("\n", "\n\n  # between\n"),
    "comment in another alphabet": "# Erdfeld in \u00b5T, \u78c1\u573a\n" + PLAIN,
    "quotes": '"x","y","z","bx","by","bz"\n' + "\n".join(",".join(f'"{c}"' for c in ln.split(",")) for ln in LINES),
    "delimiter at every line's end": PLAIN.replace("\n", ",\n"),
    "delimiter at the rows' ends": PLAIN.replace("\n", ",\n").replace("bz,\n", "bz\n"),
    "blank rows of a spreadsheet": PLAIN + ",,,,,\n,,,,,\n",
    "text in other columns": "\n".join(["room,x,y,z,bx,by,bz", *(f"kitchen,{line}" for line in LINES)]),
    "commas in quoted text": "\n".join(["room,x,y,z,bx,by,bz", *(f'"a, b",{line}' for line in LINES)]),
    "unnamed index column": "\n".join([",x,y,z,bx,by,bz", *(f"{i},{line}" for i, line in enumerate(LINES))]),
}


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", SAME_CONTENT)
def test_every_unambiguous_spelling_gives_the_same_survey(name, tmp_path):
    survey = read_survey(write(tmp_path / "survey.csv", SAME_CONTENT[name]))
    np.testing.assert_array_equal(survey.positions, NUMBERS[:, :3])
    np.testing.assert_array_equal(survey.field, NUMBERS[:, 3:])
    assert survey.times is None
    assert survey.orientations is None
    assert survey.name == "survey.csv"


def test_the_first_fault_is_named_whatever_a_later_one_is(tmp_path):
    lines = LINES * 5
    lines[7], lines[15] = "0,0,0,0,0,x", "0,0"
    path = write(tmp_path / "s.csv", "\n".join(["x,y,z,bx,by,bz", *lines]))
    with pytest.raises(DataFormatError, match="line 9, column 'bz'"):
        read_survey(path)


@pytest.mark.parametrize(("tesla", "metre"), [*zip(TESLA_PER_UNIT, 2 * [*METRE_PER_UNIT], strict=True)])
def test_units_only_scale_their_numbers(tesla, metre, tmp_path):
    path, layout = write(tmp_path / "survey.csv", PLAIN), SurveyFormat(field_unit=tesla, length_unit=metre)
    survey = read_survey_csv(path, layout)
    np.testing.assert_allclose(survey.field, NUMBERS[:, 3:] * TESLA_PER_UNIT[tesla], rtol=1e-15)
    for positions in (survey.positions, read_points(path, layout)):
        np.testing.assert_allclose(positions, NUMBERS[:, :3] * METRE_PER_UNIT[metre])


def test_sensor_vectors_without_orientations_are_refused(tmp_path):
    path = write(tmp_path / "survey.csv", PLAIN)
    with pytest.raises(DataFormatError, match="'sensor' needs orientations"):
        read_survey(path, SurveyFormat(field_frame="sensor"))


@settings(deadline=None, max_examples=25)
@given(
    positions=arrays(np.float64, (5, 3), elements=st.floats(-1e6, 1e6)),
    field=arrays(np.float64, (5, 3), elements=st.floats(-1e-2, 1e-2)),
    seed=st.integers(0, 100),
    pose_sd=st.floats(0, 10),
    has_times=st.booleans(),
)
def test_saving_and_loading_gives_the_same_bits(tmp_path_factory, positions, field, seed, pose_sd, has_times):
    turns = Rotation.random(5, rng=np.random.default_rng(seed)) if seed % 2 else None
    times = np.cumsum(np.random.default_rng(seed).uniform(0.1, 1, 5)) if has_times else None
    survey = Survey(positions, field, times, turns, frame="hall, west\n\u00b5", pose_sd=pose_sd)
    path = tmp_path_factory.mktemp("laws") / "survey.csv"
    survey.save(path)
    loaded = Survey.load(path)
    np.testing.assert_array_equal(loaded.positions, survey.positions)
    np.testing.assert_array_equal(loaded.field, survey.field)
    assert (loaded.frame, loaded.pose_sd) == (survey.frame, survey.pose_sd)
    assert (loaded.times is None) == (times is None)
    if turns is not None:
        assert loaded.orientations.approx_equal(turns, atol=1e-15).all()
    if times is not None:
        np.testing.assert_array_equal(loaded.times, times)


@pytest.mark.parametrize(
    "frame", ["survey", "hall", "hall, west", 'say "hall"', '"', " hall", "", "a\nb", "0", "NaN", "# x"]
)
def test_a_file_is_read_by_a_plain_pandas_and_its_frame_comes_back(frame, room, tmp_path):
    pd = pytest.importorskip("pandas")
    survey = replace(room, frame=frame, pose_sd=0.05)
    survey.save(tmp_path / "s.csv")
    df = pd.read_csv(tmp_path / "s.csv")
    np.testing.assert_allclose(df[["x", "y", "z", "bx", "by", "bz"]], np.c_[room.positions, room.field], rtol=1e-14)
    df.to_csv(tmp_path / "again.csv", index=False)
    survey, again = Survey.load(tmp_path / "s.csv"), Survey.load(tmp_path / "again.csv")
    assert (survey.frame, survey.pose_sd) == (frame, 0.05)
    assert (again.frame, again.pose_sd) == (frame.replace("NaN", "survey"), 0.05)  # pandas takes this name for none
    assert Survey.from_dataframe(df).pose_sd == 0.05


def test_files_of_older_versions_keep_what_their_comment_says(room, tmp_path):
    room.save(tmp_path / "s.csv")
    old = '# magmatch.survey/1 {"frame": "hall", "pose_sd": 0.05}\n' + (tmp_path / "s.csv").read_text()
    (tmp_path / "s.csv").write_text(old)
    loaded = read_survey(tmp_path / "s.csv")
    assert (loaded.frame, loaded.pose_sd) == ("hall", 0.05)


def test_two_surveys_in_one_file_are_refused_by_line(room, tmp_path):
    for frame, pose_sd, words in (("b", 0.1, "line 52, column survey_frame"), ("a", 0.2, "column pose_sd")):
        replace(room, times=None, frame="a", pose_sd=0.1).save(tmp_path / "a.csv")
        replace(room, times=None, frame=frame, pose_sd=pose_sd).save(tmp_path / "b.csv")
        rows = (tmp_path / "b.csv").read_text().splitlines()[1:]
        (tmp_path / "both.csv").write_text((tmp_path / "a.csv").read_text() + "\n".join(rows) + "\n")
        with pytest.raises(DataFormatError) as caught:
            read_survey(tmp_path / "both.csv")
        assert words in str(caught.value).replace("'", "")


def about_z(angle):
    return Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0]))


@pytest.fixture
def log(room, tmp_path):
    """A field log in the sensor's frame and the poses from another system, both of the same walk."""
    times = np.arange(0.0, 30.0, 0.5)
    angle = 0.1 * times
    trajectory = Trajectory(times, np.column_stack([times, np.sin(times), 0 * times]), about_z(angle))
    trajectory.save(tmp_path / "poses.tum")
    return tmp_path / "log.csv", tmp_path / "poses.tum", np.array([20e-6, 5e-6, -40e-6])


def write_log(path, times, field):
    lines = [",".join(map(repr, row)) for row in np.column_stack([times, field]).tolist()]
    return write(path, "\n".join(["t,bx,by,bz", *lines]))


def test_poses_from_a_trajectory_turn_the_log_into_the_survey_frame(log):
    path, poses, b_survey = log
    times = np.arange(0.2, 29.0, 0.25)
    write_log(path, times, about_z(-0.1 * times).apply(b_survey))
    survey = read_survey(path, SurveyFormat(field_frame="sensor", trajectory=poses))
    np.testing.assert_allclose(survey.field, np.tile(b_survey, (len(times), 1)), atol=1e-17)
    np.testing.assert_allclose(survey.positions[:, 0], times, atol=1e-12)
    np.testing.assert_array_equal(survey.times, times)


def test_samples_without_a_pose_are_dropped_and_counted(log, caplog):
    path, poses, b_survey = log
    times = np.arange(-1.0, 31.0, 0.25)
    write_log(path, times, np.tile(b_survey, (len(times), 1)))
    with caplog.at_level(logging.WARNING):
        survey = read_survey(path, SurveyFormat(trajectory=poses))
    assert survey.times[0] == 0.0
    assert survey.times[-1] == 29.5
    assert "dropped 9 of 128 samples without a pose (4 before the trajectory begins, 5 after it ends)" in caplog.text


def test_positions_beside_a_trajectory_are_said_to_be_ignored(log, caplog):
    path, poses, _ = log
    write(path, "\n".join(["t,x,y,z,bx,by,bz", *(f"{i},{line}" for i, line in enumerate(LINES))]))
    with caplog.at_level(logging.WARNING):
        survey = read_survey(path, SurveyFormat(trajectory=poses))
    assert "columns x, y, z are ignored" in caplog.text
    np.testing.assert_allclose(survey.positions[:, 0], np.arange(12), atol=1e-12)


def test_poses_interpolated_across_a_gap_are_said(log, caplog, tmp_path):
    path, _, b_survey = log
    times = np.concatenate([np.arange(0, 5, 0.1), np.arange(15, 20, 0.1)])
    Trajectory(times, np.column_stack([times] * 3), Rotation.identity(len(times))).save(tmp_path / "gap.tum")
    write_log(path, np.arange(0, 19, 0.5), np.tile(b_survey, (38, 1)))
    with caplog.at_level(logging.WARNING):
        read_survey(path, SurveyFormat(trajectory=tmp_path / "gap.tum"))
    assert "20 samples lie in gaps of the trajectory longer than 1 s" in caplog.text


def test_a_minus_in_columns_reverses_what_is_read_and_columns_may_be_swapped(tmp_path):
    path = write(tmp_path / "survey.csv", PLAIN)
    plain, other = read_survey(path), read_survey(path, SurveyFormat(columns="bx=by, by=bx, bz=-bz"))
    np.testing.assert_array_equal(other.field, plain.field[:, [1, 0, 2]] * [1, 1, -1])
    np.testing.assert_array_equal(other.positions, plain.positions)


def test_a_tables_own_poses_are_carried_to_the_sensor_by_its_extrinsic(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "survey.csv"
    q, mount = Rotation.random(20, random_state=rng), Rotation.from_euler("x", 90, degrees=True)
    read = rng.normal(0, 3e-5, (20, 3))
    Survey(rng.uniform(0, 5, (20, 3)), read, None, q).save(path)
    numbers = " ".join(map(str, [0.1, 0.2, 0.3, *mount.as_quat()]))
    body = read_survey(path)
    sensor = read_survey(path, SurveyFormat(extrinsic=numbers, field_frame="sensor"))
    np.testing.assert_allclose(sensor.positions, body.positions + q.apply([0.1, 0.2, 0.3]), rtol=1e-12)
    np.testing.assert_allclose(sensor.field, (q * mount).apply(read), rtol=1e-9, atol=1e-18)
    centimetres = read_survey(path, SurveyFormat(extrinsic=numbers, length_unit="cm"))
    np.testing.assert_allclose(centimetres.positions, body.positions / 100 + q.apply([0.1, 0.2, 0.3]), rtol=1e-12)
    with pytest.raises(DataFormatError, match="--extrinsic needs orientations"):
        read_survey(write(tmp_path / "plain.csv", PLAIN), SurveyFormat(extrinsic="0 0 1"))
