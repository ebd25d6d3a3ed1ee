# SPDX-License-Identifier: BSD-3-Clause
"""What a refusal says to do is done, and the file is read: all of its rows, and as the same numbers."""

import re
from pathlib import Path

import numpy as np
import pytest

from magmatch.data.formats.csv import read_points
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError
from magmatch.slam.graph.anchors import read_anchors

N = 30
RNG = np.random.default_rng(3)
NUMBERS = np.column_stack([np.arange(N) / 10, RNG.uniform(0, 3, (N, 3)).round(2), RNG.normal(28, 2, (N, 3)).round(2)])
NUMBERS[:, 6] *= -1
NAMES = "t,x,y,z,bx,by,bz"
POSES = np.column_stack([NUMBERS[:, :4], np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))])


def table(names=NAMES, mark=",", cell=repr, above="", numbers=NUMBERS):
    rows = [mark.join(map(cell, row)) for row in numbers.tolist()]
    return "\n".join([*([above] if above else []), names.replace(",", mark), *rows, ""])


def swap(old, new):
    return lambda text: text.replace(old, new)


def commas(value):
    return repr(value).replace(".", ",")


@pytest.mark.parametrize("columns", [slice(0, 7), slice(1, 7)], ids=["with times", "without"])
def test_a_table_of_numbers_is_told_its_columns_by_their_count(columns, tmp_path):
    np.savetxt(tmp_path / "walk.csv", NUMBERS[:, columns], delimiter=",")
    with pytest.raises(DataFormatError) as caught:
        read_survey(tmp_path / "walk.csv", SurveyFormat(field_unit="uT"))
    advised = re.search(r"--columns (\S+)", str(caught.value))[1]
    survey = read_survey(tmp_path / "walk.csv", SurveyFormat(field_unit="uT", columns=advised))
    np.testing.assert_array_equal(survey.positions, NUMBERS[:, 1:4])


# What is in the file, words of the message, and what following them makes of the file and of the options.
SURVEYS = {
    "names in a comment": (table("#" + NAMES), "remove the '#'", swap("#", ""), {}),
    "names and units in a comment": (
        table("# t [s], x [m], y [m], z [m], bx [uT], by [uT], bz [uT]", above="# hall 3"),
        "remove the '#'",
        lambda text: re.sub(r" \[\w+\]", "", text).replace("# t", "t"),
        {},
    ),
    "another delimiter": (table(mark="|"), "write sep=| in a line above", lambda text: "sep=|\n" + text, {}),
    "two delimiters": (table("t,x,y,z,bx,by,bz;note, free", ";", above="").replace("bz;note;", "bz;note,").replace(
        "\n", ";a\n").replace(" free;a", " free"), "write sep=; above", lambda text: "sep=;\n" + text, {}),
    "decimal commas between commas": (
        table(cell=commas), "need quotes, or semicolons", lambda _: table(mark=";", cell=commas), {}
    ),
    "commas in numbers, quoted": (
        table(cell=commas), "need quotes", lambda _: table(cell=lambda v: f'"{commas(v)}"'), {}
    ),
    "a unit behind numbers": (
        table(cell=lambda v: f"{v} u"), "write it without unit", swap(" u", ""), {}
    ),
    "negative numbers in brackets": (
        table(cell=lambda v: f"({-v})" if v < 0 else repr(v)),
        "write it without unit, brackets",
        lambda text: re.sub(r"\(([\d.]+)\)", r"-\1", text),
        {},
    ),
    "a minus behind": (
        table(cell=lambda v: f"{-v}-" if v < 0 else repr(v)),
        "such as -1234.5",
        lambda text: re.sub(r"([\d.]+)-", r"-\1", text),
        {},
    ),
    "two decimal marks": (
        table(mark=";", cell=lambda v: commas(v) if v < 0 else repr(v)), "write all decimals with a point",
        swap(",", "."), {},
    ),
    "other names": (
        table("time,px,py,pz,mx,my,mz"),
        "--columns x=THEIRS",
        lambda text: text,
        {"columns": "t=time,x=px,y=py,z=pz,bx=mx,by=my,bz=mz"},
    ),
    "a column twice": (
        table(NAMES + ",x", numbers=np.column_stack([NUMBERS, NUMBERS[:, 0]])),
        "rename the others",
        swap("bz,x", "bz,x2"),
        {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SURVEYS)
def test_advice_about_a_survey_works(case, tmp_path):
    text, words, follow, settings = SURVEYS[case]
    path = tmp_path / "s.csv"
    path.write_text(text)
    with pytest.raises(DataFormatError) as caught:
        read_survey(path, SurveyFormat(field_unit="uT"))
    assert words in str(caught.value)
    assert "--recover" not in str(caught.value)
    path.write_text(follow(text))
    survey = read_survey(path, SurveyFormat(field_unit="uT", **settings))
    np.testing.assert_array_equal(survey.times, NUMBERS[:, 0])
    np.testing.assert_array_equal(survey.positions, NUMBERS[:, 1:4])
    np.testing.assert_allclose(survey.field, NUMBERS[:, 4:] * 1e-6, rtol=1e-14)


READ_AS_THEY_ARE = {
    "a stated delimiter": table(mark=";", above="sep=;"),
    "a stated delimiter in quotes": table(mark=";", above='"sep=;"'),
    "a stated comma with blanks behind": table(above="SEP=,,,,,"),
    "a stated delimiter that is not used": table(above="sep=;"),
    "a stated tab": table(mark="\t", above="sep=\t"),
    "a comment above": table(mark=";", above="# Excel\nsep=;"),
}


@pytest.mark.parametrize("case", READ_AS_THEY_ARE)
def test_what_spreadsheets_write_is_read(case, tmp_path):
    (tmp_path / "s.csv").write_text(READ_AS_THEY_ARE[case])
    survey = read_survey(tmp_path / "s.csv", SurveyFormat(field_unit="uT"))
    np.testing.assert_allclose(survey.field, NUMBERS[:, 4:] * 1e-6, rtol=1e-14)
    np.testing.assert_array_equal(survey.times, NUMBERS[:, 0])


def poses(header, numbers=POSES, mark=" "):
    return table(header, mark, numbers=numbers)


TRAJECTORIES = {
    "numbered parts": (
        poses("# t,x,y,z,q0,q1,q2,q3"), "name all columns in the comment",
        lambda _: poses("# t,x,y,z,qx,qy,qz,qw"), {},
    ),
    "half of the names": (
        poses("# t,x,y,z,a,b,c,qx"), "or remove it if they stand so", lambda text: text.split("\n", 1)[1], {}
    ),
    "a header of other names": (
        poses("when,east,north,up,i,j,k,w", mark=","), "Name them in the header as expected",
        lambda _: poses("t,x,y,z,qx,qy,qz,qw", mark=","), {},
    ),
    "seconds in EuRoC": (
        poses("#timestamp,p_x,p_y,p_z,q_x,q_y,q_z,q_w", mark=","), "timestamp [s]",
        lambda text: text.replace("timestamp", "timestamp [s]"), {},
    ),
    "millimetres": (
        poses("# t,x_mm,y_mm,z_mm,qx,qy,qz,qw", POSES * np.array([1, 1e3, 1e3, 1e3, 1, 1, 1, 1])), "--length-unit mm",
        lambda text: text, {"length_unit": "mm"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TRAJECTORIES)
def test_advice_about_a_trajectory_works(case, tmp_path):
    text, words, follow, settings = TRAJECTORIES[case]
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(DataFormatError) as caught:
        load_trajectory(path, SurveyFormat())
    assert words in str(caught.value)
    path.write_text(follow(text))
    trajectory = load_trajectory(path, SurveyFormat(**settings))
    np.testing.assert_array_equal(trajectory.times, POSES[:, 0])
    np.testing.assert_allclose(trajectory.positions, POSES[:, 1:4], rtol=1e-14)
    np.testing.assert_allclose(trajectory.orientations.as_quat(), POSES[:, 4:], atol=1e-12)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (lambda path: read_points(path, SurveyFormat()), "# x [m], y [m], z [m]\n1,2,3\n"),
        (read_anchors, "# log,t,x,y,z,sd\nwalk,1,2,3,4,0.1\nwalk,2,2,3,4,0.1\n"),
    ],
)
def test_advice_about_names_in_a_comment_works_for_points(read, text, tmp_path):
    path = Path(tmp_path / "p.csv")
    path.write_text(text)
    with pytest.raises(DataFormatError, match="remove the '#'"):
        read(path)
    path.write_text(re.sub(r" \[m\]", "", text).replace("# ", ""))
    assert len(read(path)) > 0


def test_names_that_are_strange_are_not_taken_for_a_row_under_a_comment(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("# points of the hall\neast,north,up,note\n1,2,3,4\n")
    with pytest.raises(DataFormatError, match="found east, north, up, note") as caught:
        read_points(path, SurveyFormat())
    assert "#" not in str(caught.value)
