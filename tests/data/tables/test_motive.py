# SPDX-License-Identifier: BSD-3-Clause
"""Motive's CSV: rows of types, names and axes above the numbers, y up, in the unit that its first row states."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.cli.main import main
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.read import read_survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError

N = 40
FACTS = "Format Version,1.23,Take Name,Take 1,Rotation Type,{rotation},Length Units,{unit},Coordinate Space,Global"
PER_METRE = {"Meters": 1, "Centimeters": 100, "Millimeters": 1000}
# Motive's axes by those of z up: x stays, y is up, so z points backward.
Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])


@pytest.fixture
def walk(rng):
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.1, (N, 3)), axis=0))
    return Trajectory(np.arange(N) / 100, np.cumsum(rng.normal(0, 0.1, (N, 3)), axis=0), turns)


def block(kind, name, parts):
    """Four rows of a header for some columns: type, name, ID, parts and axes."""
    axes = {"Rotation": "XYZW", "Euler": "XYZ", "Position": "XYZ", "Mean Marker Error": [""]}
    return [(kind, name, "1", "Rotation" if part == "Euler" else part, axis) for part in parts for axis in axes[part]]


BODY = block("Rigid Body", "robot", ["Rotation", "Position", "Mean Marker Error"])
MARKER = block("Rigid Body Marker", "robot:Marker1", ["Position"])


def export(path, walk, columns=BODY, unit="Millimeters", *, labels=("Type", "Name", "ID", ""), lost=(), more=""):
    """Write a walk as Motive does."""
    facts = FACTS.format(rotation="Quaternion", unit=unit)
    positions, turns = walk.positions @ Y_UP.T * PER_METRE[unit], Rotation.from_matrix(Y_UP) * walk.orientations
    head = [",".join(["", label, *cells]) for label, *cells in zip(labels, *(c[:4] for c in columns), strict=True)]
    axes = ",".join(["Frame", "Time (Seconds)", *(column[4] for column in columns)])
    lines = [facts, "", *head, axes]
    for k, (t, q, p) in enumerate(zip(walk.times, turns.as_quat(), positions, strict=True)):
        cells = [*map(repr, [*q.tolist(), *p.tolist(), 0.2][: len(columns)])]
        cells += ["0.5"] * (len(columns) - len(cells))
        lines.append(",".join([str(k), repr(float(t)), *([""] * len(cells) if k in lost else cells)]))
    path.write_text("\n".join([*lines, more]))
    return path


@pytest.mark.parametrize("labels", [("Type", "Name", "ID", ""), ("", "", "", "")])
@pytest.mark.parametrize("unit", PER_METRE)
def test_a_rigid_body_is_read_in_metres_with_z_up(unit, labels, walk, tmp_path, caplog, capsys):
    path = export(tmp_path / "take.csv", walk, [*BODY, *MARKER], unit, labels=labels)
    read = load_trajectory(path, SurveyFormat())
    for found in (read, Trajectory.load(path), load_trajectory(path, SurveyFormat(length_unit="mm"))):
        np.testing.assert_array_equal(found.times, walk.times)
        np.testing.assert_allclose(found.positions, walk.positions, atol=1e-12)
        assert (found.orientations * walk.orientations.inv()).magnitude().max() < 1e-12
    assert "taken as y up" in caplog.text
    assert main(["info", str(path)]) == 0
    assert "trajectory" in capsys.readouterr().out


def test_frames_in_which_the_body_is_not_seen_are_left_out(walk, tmp_path, caplog):
    read = load_trajectory(export(tmp_path / "take.csv", walk, lost=range(7, 12)), SurveyFormat())
    np.testing.assert_array_equal(read.times, np.delete(walk.times, range(7, 12)))
    assert "left out 5 of 40 frames in which robot is not seen" in caplog.text


REFUSED = {
    "markers only": (block("Marker", "Unlabeled", ["Position"]), "found Marker: make one of the markers in Motive"),
    "two bodies": ([*BODY, *block("Rigid Body", "wand", ["Rotation"])], "expected one rigid body, found robot, wand"),
    "angles": (
        block("Rigid Body", "robot", ["Euler", "Position"]),
        "missing qw: export both, with the rotation type Q",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_another_export_is_refused_with_how_to_export(name, walk, tmp_path):
    columns, words = REFUSED[name]
    with pytest.raises(DataFormatError, match=words):
        load_trajectory(export(tmp_path / "take.csv", walk, columns), SurveyFormat())


def test_faults_are_named_by_their_line(walk, tmp_path):
    path = export(tmp_path / "take.csv", walk, more="40,0.4,1,1,0,0,5,5,5,0.1\n")
    with pytest.raises(DataFormatError, match=r"line 48, column 'qx\.\.qw': expected a unit quaternion"):
        load_trajectory(path, SurveyFormat())
    path.write_text(path.read_text().replace("Millimeters", "Furlongs"))
    with pytest.raises(DataFormatError, match=r"line 1: expected Length Units of meters, .*; found 'furlongs'"):
        load_trajectory(path, SurveyFormat())
    path.write_text(FACTS + "\n")
    with pytest.raises(DataFormatError, match="export it with its header"):
        load_trajectory(path, SurveyFormat())
    with pytest.raises(DataFormatError, match="holds poses"):
        read_survey(path)
