# SPDX-License-Identifier: BSD-3-Clause
"""Phone logs at fault: one line that names the file, the line or field, what was expected and what was found."""

import gzip

import pytest

from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.formats.sniff import sniff
from magmatch.errors import DataFormatError

HEAD = "% GetSensorData\n"
ROWS = "".join(f"MAGN;{0.02 * i:.2f};{5 + 0.02 * i:.2f};20;3;-45;3\n" for i in range(20))
TABLE = '"Time (s)","X (µT)","Y (µT)","Z (µT)"\n0,1,2,3\n1,1,2,3\n'
ANDROID = "event.timestamp,sensor,x,y,z\n"


def read(path):
    sniff(path)
    return read_phone_log(path)


def refusal(path):
    with pytest.raises(DataFormatError) as caught:
        read(path)
    words = str(caught.value)
    assert words.startswith(str(path))
    assert "\n" not in words
    return words


TEXTS = {
    "NaN": (HEAD + ROWS + "ACCE;1;6;nan;3;-45;3\n", "column 'x': expected a finite number, found 'nan'"),
    "a row cut off": (
        HEAD + ROWS + "GYRO;1;6;20",
        "line 22: expected 6 cells (sensor, app time, sensor time, x, y, z), found 4",
    ),
    "a clock set back": (HEAD + ROWS + "MAGN;1;2;20;3;-45;3\n", "line 22: time runs backward by"),
    "an Android word": (
        ANDROID + "1000000,2,1,2,3\n2000000,2,1,north,3\n",
        "line 3, column 'y': expected a number, found 'north'",
    ),
}


@pytest.mark.parametrize("case", TEXTS)
@pytest.mark.parametrize("wrap", [bytes, gzip.compress])
def test_a_fault_in_a_text_log_is_named_by_line(wrap, case, tmp_path):
    text, words = TEXTS[case]
    (tmp_path / "log.txt").write_bytes(wrap(text.encode()))
    assert words in refusal(tmp_path / "log.txt")


@pytest.mark.parametrize("case", [case for case in TEXTS if "clock" not in case])
def test_rows_at_fault_are_left_out_where_asked_for(case, tmp_path, caplog):
    (tmp_path / "log.txt").write_text(TEXTS[case][0])
    assert len(read_phone_log(tmp_path / "log.txt", recover=True).streams["field"]) in {1, 20}
    assert "left out 1 row" in caplog.text


@pytest.mark.parametrize(("row", "words"), [("1;6;1e300;3;-45", "column 'x'"), ("1;1e200;20;3;-45", "column 'time'")])
def test_numbers_that_no_phone_reads_are_refused(row, words, tmp_path):
    (tmp_path / "log.txt").write_text(f"{HEAD}{ROWS}MAGN;{row};3\n")
    said = refusal(tmp_path / "log.txt")
    assert "line 22" in said
    assert words in said
    assert "expected numbers of phones" in said


def test_a_sensor_that_is_missing_is_named_beside_those_that_are_there(tmp_path):
    (tmp_path / "log.txt").write_text(HEAD + ROWS)
    with pytest.raises(DataFormatError, match="expected readings of the gyroscope for a test; found sensors: magnet"):
        read_phone_log(tmp_path / "log.txt").require("rate", "a test")


@pytest.mark.parametrize("names", [("[Content_Types].xml", "xl/workbook.xml"), ("walk.xlsx",), ("Raw Data.xls",)])
def test_workbooks_are_refused_with_what_to_choose_instead(names, tmp_path, zipped):
    words = refusal(zipped(tmp_path / "walk.xlsx", dict.fromkeys(names, "x")))
    assert "Excel workbook" in words
    assert "phyphox: choose CSV" in words


@pytest.mark.parametrize("stray", ["../x.csv", "a/../../x", "/etc/x", "\\\\host\\x", "C:\\x", "..\\x"])
def test_names_that_leave_an_archive_are_refused(stray, tmp_path, zipped):
    assert "leaves the archive" in refusal(zipped(tmp_path / "walk.zip", {"Magnetometer.csv": TABLE, stray: ""}))


def test_what_systems_keep_beside_files_is_not_read(tmp_path, zipped):
    members = {"__MACOSX/._Magnetometer.csv": b"\0\5\x16\7", "walk/Magnetometer.csv": TABLE}
    assert len(read_phone_log(zipped(tmp_path / "walk.zip", members)).streams["field"]) == 2
