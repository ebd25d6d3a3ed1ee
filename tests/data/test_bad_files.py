# SPDX-License-Identifier: BSD-3-Clause
"""Every way a file can be wrong ends in one line that says where, what was expected and what was found."""

import gzip
import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError, SurveyError
from magmatch.store import dumps

HEADER = "x,y,z,bx,by,bz"


def rows(n=12, scale=1e-6, step=0.1):
    return [
        f"{step * i},{(step * i) ** 2},{0.3 * (i % 3)},{20 * scale},{3 * scale},{-45 * scale - i * scale / 10}"
        for i in range(n)
    ]


def table(*lines, header=HEADER):
    return "\n".join([header, *lines, ""])


def with_row(k, text):
    """Good rows, but row k (counted from 1; it stands on line k + 1) is this text."""
    lines = rows()
    lines[k - 1] = text
    return table(*lines)


def timed(times):
    return table(*(f"{t},{row}" for t, row in zip(times, rows(len(times)), strict=True)), header="t," + HEADER)


def turned(quaternion, header="qx,qy,qz,qw"):
    lines = [f"{row},0,0,0,1" for row in rows()]
    lines[4] = f"{rows()[4]},{quaternion}"
    return table(*lines, header=f"{HEADER},{header}")


TIMES = list(np.arange(12) / 10)

TABLE_CASES = {
    "empty file": ("", ["empty"]),
    "comments only": ("# x,y,z\n\n# nothing\n", ["only comments"]),
    "header only": (table(), ["header row but no samples"]),
    "no header": ("\n".join(rows()), ["line 1", "header row", "found numbers"]),
    "header commented out": ("# " + HEADER + "\n" + "\n".join(rows()), ["line 2", "remove the '#'"]),
    "a number with an underscore": (with_row(3, "1_0,0,0,2e-5,0,0"), ["line 4, column 'x'", "found '1_0'"]),
    "missing column": (table(*rows(), header="x,y,z,bx,by,up"), ["missing bz", "found x, y, z, bx, by, up"]),
    "unit in a name": (table(*rows(), header="x,y,z,bx [uT],by,bz"), ["missing bx", "bx [ut]"]),
    "log without positions": (table("0,1,2,3", header="t,bx,by,bz"), ["missing x, y, z", "--trajectory"]),
    "duplicate column": (table(*rows(), header="x,y,z,bx,bx,bz"), ["line 1", "column 'bx'", "2 times"]),
    "text in a number": (with_row(3, "0,0,0,fast,0,0"), ["line 4", "column 'bx'", "expected a number", "'fast'"]),
    "comment behind a row": (with_row(2, "0,0,0,1e-6,0,0 # corner"), ["line 3", "column 'bz'", "# corner"]),
    "empty cell": (with_row(5, "0,,0,1e-6,0,0"), ["line 6", "column 'y'", "empty cell"]),
    "short row": (with_row(7, "0,0,0,1e-6"), ["line 8", "expected 6 cells", "found 4"]),
    "long row": (with_row(7, "0,0,0,1e-6,0,0,9"), ["line 8", "expected 6 cells", "found 7"]),
    "commas and points": (
        table("0;0;0;0,2;0;0.5", header="x;y;z;bx;by;bz"),
        ["line 2", "column 'bz'", "with a point"],
    ),
    "cut off": (table(*rows()).rstrip("\n")[:-30], ["line 13", "found 4", "cut off"]),
    "two delimiters": (table(*rows(), header="x,y,z;bx,by,bz"), ["line 1", "both ',' and ';'"]),
    "another delimiter": (table(*rows(), header="x|y|z|bx|by|bz"), ["expected columns", "found x|y|z|bx|by|bz"]),
    "nan": (with_row(9, "0,0,0,nan,0,0"), ["line 10", "column 'bx'", "finite", "'nan'"]),
    "half a quaternion": (
        table(*(f"{r},0,0" for r in rows()), header=HEADER + ",qx,qy"),
        ["half a quaternion", "found qx, qy", "missing qz, qw"],
    ),
    "zero quaternion": (turned("0,0,0,0"), ["line 6", "zero quaternion"]),
    "huge quaternion": (turned("0,0,0,1e200"), ["line 6", "one of length inf"]),
    "time repeats": (timed([*TIMES[:5], TIMES[4], *TIMES[6:]]), ["line 7", "column 't'", "time repeats", "0.4"]),
    "time runs backward": (timed([*TIMES[:5], 0.0, *TIMES[6:]]), ["line 7", "column 't'", "backward", "0 after 0.4"]),
    "latin-1": ((HEADER + ",ort\n" + rows()[0] + ",Süd\n").encode("latin-1"), ["line 2", "not UTF-8", "0xfc"]),
    "zeros behind the rows": (table(*rows()).encode() + bytes(64), ["line 14", "NUL"]),
    "damaged frame note": ("# magmatch.survey/1 {oops\n" + table(*rows()), ["magmatch.survey/1", "{oops"]),
    "impossible accuracy note": ('# magmatch.survey/1 {"pose_sd": -1}\n' + table(*rows()), ["pose_sd"]),
}  # fmt: skip


def zipped(**members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def npz():
    buffer = io.BytesIO()
    np.savez(buffer, a=np.zeros(3))
    return buffer.getvalue()


FOREIGN_CASES = {
    "gzip, cut off": (gzip.compress(table(*rows()).encode())[:-20], ["damaged gzip", "cut off"]),
    "gzip of a zip": (gzip.compress(zipped(a="b")), ["gzip", "gunzip"]),
    "bzip2": (b"BZh91AY", ["bzip2"]),
    "ROS 1 bag": (b"#ROSBAG V2.0\n" + bytes(100), ["damaged ROS 1 bag", "rosbag reindex mends it"]),
    "MCAP": (b"\x89MCAP0\r\n" + bytes(20), ["damaged MCAP file", "mcap recover mends it"]),
    "ULog": (b"ULog\x01\x12\x35" + bytes(20), ["ULog"]),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(20), ["damaged MATLAB file"]),
    "MATLAB": (b"MATLAB 5.0 MAT-file, Platform: X" + bytes(99), ["damaged MATLAB file"]),
    "PNG": (b"\x89PNG\r\n\x1a\n" + bytes(20), ["PNG picture"]),
    "PDF": (b"%PDF-1.7\n", ["PDF"]),
    "pickle": (b"\x80\x04\x95" + bytes(20), ["pickle"]),
    "web page": (b"<!DOCTYPE html><html></html>", ["web page", "raw file"]),
    "LFS pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", ["Git LFS"]),
    "Excel": (zipped(**{"[Content_Types].xml": "<a/>"}), ["Excel", "CSV"]),
    "NumPy archive": (npz(), ["npz"]),
    "zipped CSV": (zipped(**{"survey.csv": table(*rows())}), ["zip archive", "unpack"]),
    "damaged zip": (zipped(a="b")[:20], ["damaged zip"]),
    "a saved map": (bytes(8) + b'{"__metadata__":{', ["saved map", "FieldMap.load"]),
    "a saved session": (dumps("magmatch.slam.session/9", {}), ["magmatch.slam.session/9", "expected a survey"]),
    "another zip": (zipped(**{"a.bin": "x"}), ["zip archive", "unpack"]),
    "a registration": (b'{"schema": "magmatch.registration/1"}', ["registration result", "expected a survey"]),
    "other JSON": (b'{"schema": "other/1"}', ["other/1"]),
    "a phone's JSON": (b'[{"sensor": "Magnetometer", "x": "1"}]', ["a phone's log in JSON", "export it as CSV"]),
    "broken JSON": (b'{"schema": ', ["JSON"]),
    "endless JSON": (b"[" * 200_000, ["JSON"]),
    "a pose graph": ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", ["g2o pose graph", "no times", "rows t x y z qx qy qz qw"]),
    "a trajectory": ("\n".join(f"{i} 0 0 0 0 0 0 1" for i in range(20)), ["TUM", "no field", "--trajectory"]),
}


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", [*TABLE_CASES, *FOREIGN_CASES])
def test_bad_file_is_refused_in_one_line_that_names_the_place(name, tmp_path):
    content, fragments = (TABLE_CASES | FOREIGN_CASES)[name]
    path = write(tmp_path / "survey.csv", content)
    with pytest.raises(DataFormatError) as caught:
        read_survey(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) - len(str(path)) < 300
    for fragment in fragments:
        assert fragment in message


# Numbers as they stand in the file, the unit they are read as, and what the message must suggest.
UNIT_CASES = [(1.0, "T", "--field-unit uT"), (1e-6, "uT", "--field-unit T"), (1.0, "mT", "--field-unit uT")]


@pytest.mark.parametrize(("scale", "unit", "flag"), UNIT_CASES)
def test_wrong_field_unit_is_refused_with_the_flag_that_helps(scale, unit, flag, tmp_path):
    path = write(tmp_path / "survey.csv", table(*rows(scale=scale)))
    with pytest.raises(SurveyError, match=flag) as caught:
        read_survey(path, SurveyFormat(field_unit=unit))
    assert str(path) in str(caught.value)


TUM_CASES = {
    "seven columns": ("0 0 0 0 0 0 0\n" * 3, ["line 1", "expected rows of t, x, y, z", "found 7 cells"]),
    "header without qw": ("t x y z qx qy qz q\n0 0 0 0 0 0 0 1\n", ["line 1", "missing qw", "found t, x, y"]),
    "KITTI": ("1 0 0 5 0 1 0 6 0 0 1 7\n" * 3, ["line 1", "12 numbers a row are KITTI poses", "no times", "t x y z"]),
    "one pose": ("0 0 0 0 0 0 0 1\n", ["at least two poses", "found 1"]),
    "time backward": ("# c\n1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", ["line 3", "backward"]),
    "zero quaternion": ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", ["line 2", "zero quaternion"]),
}


@pytest.mark.parametrize("name", TUM_CASES)
def test_bad_trajectory_is_refused_with_its_line(name, tmp_path):
    content, fragments = TUM_CASES[name]
    path = write(tmp_path / "poses.tum", content)
    with pytest.raises(DataFormatError) as caught:
        Trajectory.load(path)
    for fragment in (str(path), *fragments):
        assert fragment in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(DataFormatError, match=r"nowhere\.csv: no such file"):
        read_survey(tmp_path / "nowhere.csv")


def test_device_is_not_a_survey():
    with pytest.raises(DataFormatError, match="not a regular file"):
        read_survey(os.devnull)


@pytest.mark.parametrize("path", ["a" * 5000, "a\0b"])
def test_impossible_name_is_refused(path):
    with pytest.raises(DataFormatError):
        read_survey(path)


def test_unreadable_file_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "secret.csv", table(*rows()))

    def refuse(*_args, **_kwargs):
        raise PermissionError

    monkeypatch.setattr(Path, "open", refuse)  # file modes do not stop the superuser, who may run the tests
    with pytest.raises(DataFormatError, match="no permission"):
        read_survey(path)
