# SPDX-License-Identifier: BSD-3-Clause
"""Which files a folder of logs stands for."""

from pathlib import Path

import pytest

from magmatch.cli.inputs import logs_in
from magmatch.errors import DataFormatError

TABLE = "t,x,y,z,bx,by,bz\n0,0,0,0,1e-5,2e-5,3e-5\n"
PHONE = "% GetSensorData\nMAGN;0;0;1;2;3;3\n"


def test_a_folder_stands_for_its_logs_and_says_what_is_not_read(tmp_path, capsys):
    (tmp_path / "b.txt").write_text(PHONE)
    (tmp_path / "a.txt").write_text(PHONE)
    (tmp_path / "drive.bag").write_text("#ROSBAG V2.0\n")
    (tmp_path / ".hidden.txt").write_text(PHONE)
    (tmp_path / "notes.csv").write_text(TABLE)
    assert logs_in([tmp_path]) == [tmp_path / name for name in ("a.txt", "b.txt", "drive.bag")]
    assert capsys.readouterr().err == f"{tmp_path}: 3 logs; not read: notes.csv\n"
    assert logs_in([tmp_path / "b.txt", tmp_path / "notes.csv"]) == [tmp_path / "b.txt", tmp_path / "notes.csv"]


def test_tables_are_the_logs_where_there_are_no_others(tmp_path):
    for name in ("two.csv", "one.csv"):
        (tmp_path / name).write_text(TABLE)
    (tmp_path / "info.json").write_text("{}")
    assert logs_in([tmp_path]) == [tmp_path / "one.csv", tmp_path / "two.csv"]


def test_a_folder_that_is_a_log_stands_for_itself(tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / "walk.txt").write_text(PHONE)
    assert logs_in([tmp_path]) == [tmp_path]


def test_a_pattern_that_the_shell_left_stands_for_the_logs_that_it_matches(tmp_path, monkeypatch):
    (tmp_path / "floor").mkdir()
    first, a, b = (tmp_path / "floor" / name for name in ("[1].txt", "a.txt", "b.txt"))
    for log in (b, a, first):
        log.write_text(PHONE)
    assert logs_in([tmp_path / "floor" / "*.txt"]) == [first, a, b]
    assert logs_in([tmp_path / "*" / "[ab].txt", first]) == [a, b, first]
    monkeypatch.chdir(tmp_path)
    assert logs_in([Path("floor/a*")]) == [Path("floor/a.txt")]
    with pytest.raises(DataFormatError, match=r"\*\.csv: matches no file"):
        logs_in([tmp_path / "floor" / "*.csv"])


def test_a_folder_without_logs_is_refused(tmp_path):
    (tmp_path / "info.json").write_text("{}")
    with pytest.raises(DataFormatError, match="is a folder, expected"):
        logs_in([tmp_path])
    with pytest.raises(DataFormatError, match="no such file"):
        logs_in([tmp_path / "nowhere"])
