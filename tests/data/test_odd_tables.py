# SPDX-License-Identifier: BSD-3-Clause
"""Tables as people have them: decimal commas, missing readings, a last line cut, degrees, half of the columns."""

import logging

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.phones.tables import columns_of
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.errors import DataFormatError
from magmatch.number_text import many

N = 60


@pytest.fixture
def rows(rng):
    """Times, positions and field (uT), rounded as loggers do, so that text holds them exactly."""
    return np.round(np.column_stack([np.arange(N) / 10, rng.uniform(0, 3, (N, 3)), rng.normal(28, 2, (N, 3))]), 4)


def write(path, rows, names="t,x,y,z,bx,by,bz", mark=",", change=lambda i, cells: cells):
    lines = [change(i, [repr(float(v)) for v in row]) for i, row in enumerate(rows)]
    path.write_text("\n".join([names.replace(",", mark), *(mark.join(cells) for cells in lines)]))
    return path


UT, RECOVER = SurveyFormat(field_unit="uT"), SurveyFormat(field_unit="uT", recover=True)


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("note", ["", "12.03.2026"])
def test_decimal_commas_between_semicolons_or_tabs_are_the_same_numbers(mark, note, rows, tmp_path, caplog):
    names = "t,x,y,z,bx,by,bz" + (",day" if note else "")

    def commas(_, cells):
        return [cell.replace(".", ",") for cell in cells] + ([note] if note else [])

    with caplog.at_level(logging.WARNING, logger="magmatch"):
        survey = read_survey(write(tmp_path / "german.csv", rows, names, mark, commas), UT)
    plain = read_survey(write(tmp_path / "plain.csv", rows), UT)
    np.testing.assert_array_equal(survey.field, plain.field)
    np.testing.assert_array_equal(survey.times, plain.times)
    assert "german.csv: decimal commas were read as points" in caplog.text


DAMAGE = {
    "no reading": (lambda i, c: [*c[:4], "nan", "nan", "nan"] if 20 <= i < 30 else c, 10, 22, "found 'nan'"),
    "empty cells": (lambda i, c: [*c[:4], "", "", ""] if i in (0, 7) else c, 2, 2, "empty cell"),
    "errors of a spreadsheet": (lambda i, c: [*c[:4], "#DIV/0!", "#N/A", "n/a"] if i == 5 else c, 1, 7, "'#DIV/0!'"),
    "a dash": (lambda i, c: [*c[:6], "\u2013"] if i == 5 else c, 1, 7, "found '\u2013'"),
    "words": (lambda i, c: ["-- restart --"] if i == 40 else c, 1, 42, "expected 7 cells"),
    "cut off": (lambda i, c: c[:3] if i == N - 1 else c, 1, N + 1, "ends in the middle of this line"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_rows_that_cannot_be_read_are_left_out_when_asked_for(name, rows, tmp_path, caplog):
    change, n_lost, line, words = DAMAGE[name]
    path = write(tmp_path / "s.csv", rows, change=change)
    with pytest.raises(DataFormatError, match=rf"line {line}\b.*{words}.*--recover leaves such rows out"):
        read_survey(path, UT)
    with caplog.at_level(logging.WARNING, logger="magmatch"):
        survey = read_survey(path, RECOVER)
    kept = [i for i in range(N) if change(i, ["0"] * 7) == ["0"] * 7]
    np.testing.assert_array_equal(survey.positions, rows[kept, 1:4])
    assert len(survey) == N - n_lost
    assert f"left out {many(n_lost, 'row')} that cannot be read, the first: {path}, line {line}" in caplog.text


def test_nothing_but_damage_is_refused_all_the_same(rows, tmp_path):
    path = write(tmp_path / "s.csv", rows, change=lambda _, cells: ["2026-13-01T10:00:00Z", *cells[1:]])
    with pytest.raises(DataFormatError, match=r"line 2, column 't'.*times are numbers, or dates such as"):
        read_survey(path, RECOVER)


def test_other_columns_stay_beside_the_rows_that_are_kept(rows, tmp_path):
    change = DAMAGE["no reading"][0]
    names = "t,x,y,z,bx,by,bz,motor_a"
    path = write(tmp_path / "s.csv", rows, names, change=lambda i, cells: [*change(i, cells), str(i)])
    survey, channels = read_survey_and_channels(path, RECOVER)
    np.testing.assert_array_equal(channels["motor_a"], [i for i in range(N) if not 20 <= i < 30])
    assert len(survey) == len(channels["motor_a"])


HEADERS = {
    "time,latitude,longitude,altitude,mag_x,mag_y,mag_z": "--columns lat=THEIRS",
    "timestamp,px,py,pz,mx,my,mz": "--columns x=THEIRS",
    "t,x,y,note,bx,by,bz": "--columns z=0",
    "t,x,y,z,mag,a,b": "its magnitude alone will not do",
    "t,a,b,c,bx,by,bz": "--trajectory POSES.tum",
    "t,lat,lon,c,bx,by,bz": "--columns z=0",
}


@pytest.mark.parametrize("names", HEADERS)
def test_other_columns_are_refused_with_advice(names, rows, tmp_path):
    with pytest.raises(DataFormatError, match=HEADERS[names]):
        read_survey(write(tmp_path / "s.csv", rows, names), UT)


def test_a_quoted_cell_of_any_length_is_a_cell(rows, tmp_path):
    note = f'"{"x" * 200_000}"'  # more than Python's own reader of CSV takes
    plain = read_survey(write(tmp_path / "s.csv", rows), UT)
    path = write(tmp_path / "n.csv", rows, "t,x,y,z,bx,by,bz,note", change=lambda _, cells: [*cells, note])
    np.testing.assert_array_equal(read_survey(path, UT).field, plain.field)
    path.write_text(path.read_text().replace(note, "", 1).replace("\n", f"\n{note},", 1))
    with pytest.raises(DataFormatError, match="line 2"):
        read_survey(path, UT)


@pytest.mark.parametrize("mark", [" ", ",", "\t"])
def test_row_names_of_r_need_no_name_in_the_header(mark, rows, tmp_path, caplog):
    names = ",".join(f'"{name}"' for name in ("t", "x", "y", "z", "bx", "by", "bz"))
    path = write(tmp_path / "r.txt", rows, names, mark, lambda i, cells: [f'"{i + 1}"', *cells])
    np.testing.assert_array_equal(read_survey(path, UT).times, rows[:, 0])
    assert "without a name" not in caplog.text


def test_what_may_be_a_last_column_without_a_name_is_no_row_name(rows, tmp_path):
    for mark, first in ((",", '"2026-05-01T10:00:00"'), (" ", "1")):  # a quoted date, a number
        path = write(tmp_path / "r.txt", rows, mark=mark, change=lambda _, cells, first=first: [first, *cells])
        with pytest.raises(DataFormatError, match=r"line 2: expected 7 cells .* row n.* need a name"):
            read_survey(path, UT)
    quoted = write(tmp_path / "quoted.csv", rows, change=lambda _, cells: [f'"{cell}"' for cell in (*cells, "")])
    np.testing.assert_array_equal(read_survey(quoted, UT).times, rows[:, 0])


@pytest.mark.parametrize("layout", [UT, RECOVER])
@pytest.mark.parametrize("names", ["t,x,y,z,bx,by,bz", "X,Y,Z,Bx,By,Bz"])
def test_two_tables_in_one_file_are_not_one_survey(layout, names, rows, tmp_path):
    path = write(tmp_path / "two.csv", rows[:, -len(names.split(",")) :], names)
    path.write_text(f"{path.read_text()}\n{path.read_text()}")
    said = "repeats the header: two tables.*; split the file"
    if layout is RECOVER and names.startswith("t"):
        said = ".*time runs backward"  # a header amid one recording, whose times go on, is left out
    with pytest.raises(DataFormatError, match=rf"line \d+[^:]*: {said}"):
        read_survey(path, layout)


def test_a_header_printed_anew_amid_a_recording_is_left_out(rows, tmp_path):
    path = write(tmp_path / "again.csv", rows)
    header, *below = path.read_text().splitlines()
    path.write_text("\n".join([header, *below[:20], header, *below[20:]]))
    with pytest.raises(DataFormatError, match=r"repeats the header.*--recover leaves such rows out of one recording"):
        read_survey(path, UT)
    np.testing.assert_array_equal(read_survey(path, RECOVER).times, rows[:, 0])


TITLES = {
    "a title and a blank line": "Survey of hall 3\n\n",
    "cells of a spreadsheet": "Survey of hall 3;;;;;;\nOperator: X. Y.;;;;;;\n;;;;;;\n".replace(";", ","),
    "groups of columns": "Time,Position,,,Field,,,\n",
    "another program's comments": "// export; version 1, of 2\n; t, and the rest\n%\n",
    "names and values": '"Product","Logger 2"\n"rate",50\n',
    "a title that names a column": "field of T\n",
}


@pytest.mark.parametrize("titles", TITLES.values(), ids=TITLES)
@pytest.mark.parametrize("first", ["", "sep=,\n"])
def test_titles_above_a_header_of_known_names_are_left_out(titles, first, rows, tmp_path, caplog):
    names = "t,x,y,z,bx,by,bz,motor"
    plain = write(tmp_path / "plain.csv", np.column_stack([rows, rows[:, 0]]), names)
    (tmp_path / "titled.csv").write_text(first + titles + plain.read_text())
    survey, channels = read_survey_and_channels(tmp_path / "titled.csv", UT)
    np.testing.assert_array_equal(survey.field, read_survey(plain, UT).field)
    np.testing.assert_array_equal(channels["motor"], survey.times)
    assert not caplog.text


@pytest.mark.parametrize("names", ["", "a,b,c,d,e,f,g\n"])
def test_titles_may_stand_above_columns_known_by_number(names, rows, tmp_path):
    plain = write(tmp_path / "plain.csv", rows)
    path = tmp_path / "titled.csv"
    path.write_text("Survey; hall 3, x\nby X. Y.\n" + names + plain.read_text().partition("\n")[2])
    layout = UT.model_copy(update={"columns": "t=1,x=2,y=3,z=4,bx=5,by=6,bz=7"})
    np.testing.assert_array_equal(read_survey(path, layout).field, read_survey(plain, UT).field)


def test_titles_may_stand_above_names_that_are_stated_and_above_poses(rows, tmp_path):
    text = write(tmp_path / "a.csv", rows[:, [0, 4, 5, 6]], "clock,mx,my,mz").read_text()
    (tmp_path / "a.csv").write_text("Log 7\n" + text)
    poses = np.column_stack([rows[:, :4], np.tile([0, 0, 0, 1], (N, 1))])
    text = write(tmp_path / "b.csv", poses, "t,x,y,z,qx,qy,qz,qw").read_text()
    (tmp_path / "b.csv").write_text("Poses of hall 3; x, y\n" + text)
    layout = UT.model_copy(update={"columns": "t=clock,bx=mx,by=my,bz=mz", "trajectory": tmp_path / "b.csv"})
    np.testing.assert_allclose(read_survey(tmp_path / "a.csv", layout).field, rows[:, 4:] * 1e-6)


def test_a_table_without_known_names_says_which_line_it_takes_for_the_header(tmp_path):
    (tmp_path / "walk.csv").write_text("\nSurvey of hall 3\nclock,mx,my,mz\n" + "0,1,2,3\n" * 9)
    with pytest.raises(
        DataFormatError,
        match=r"csv, line 2: expected columns such as .*; found survey, of, hall, 3; if the header stands further",
    ):
        read_survey(tmp_path / "walk.csv")
    with pytest.raises(DataFormatError, match=r"walk\.csv, line 2: expected a column 'b1' for bx, found survey, of"):
        read_survey(tmp_path / "walk.csv", SurveyFormat(columns="bx=b1,by=my,bz=mz"))


@pytest.mark.parametrize("above", ["0.0,1.0,2.0", "0.05,1,2,3", "0,1,2,3,1e-5,2e-5,3e-5"])
def test_numbers_above_a_header_are_no_titles(above, tmp_path):
    """They are samples, of a log that was joined or cut: no header hides them."""
    rows = "\n".join(f"{0.1 * k},{k},0,0,{1e-5 + 1e-7 * k},2e-5,3e-5" for k in range(30))
    path = tmp_path / "joined.csv"
    path.write_text(f"{above}\nt,x,y,z,bx,by,bz\n{rows}\n")
    with pytest.raises(DataFormatError):
        read_survey(path)


def test_a_survey_in_millimetres_is_no_phones_log():
    names = "timestamp (s),x (mm),y (mm),z (mm),B x (µT),B y (µT),B z (µT)"
    assert columns_of([name.lower() for name in names.split(",")], "survey") is None
