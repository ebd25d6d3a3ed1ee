# SPDX-License-Identifier: BSD-3-Clause
"""Parquet, phone and EuRoC files that cannot be read, by name: one line each."""

import os

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.tables.tum import write_tum
from magmatch.errors import DataFormatError

N = 20


def refusal(path, **settings):
    with pytest.raises(DataFormatError) as caught:
        read_survey(path, SurveyFormat(**settings))
    words = str(caught.value)
    assert "\n" not in words
    assert len(words) - len(str(path)) < 400
    return words


# --- Parquet -------------------------------------------------------------------------------------------------------


def good():
    rng = np.random.default_rng(0)
    columns = {"t": np.arange(N) / 10.0}
    columns |= {name: rng.uniform(0, 2, N) for name in "xyz"}
    return columns | {name: rng.normal(2e-5, 1e-6, N) for name in ("bx", "by", "bz")}


def without(name):
    return {key: value for key, value in good().items() if key != name}


def repeated():
    return good() | {"t": np.round(np.arange(N) / 2)}


def at(name, row, value):
    columns = good()
    columns[name] = columns[name].copy()
    columns[name][row] = value
    return columns


COLUMNS = {
    "a missing column": (lambda: without("bz"), "missing bz"),
    "NaN": (lambda: at("by", 6, np.nan), "line 7, column 'by': expected a finite number"),
    "null": (lambda: good() | {"x": [0.0] * 4 + [None] + [1.0] * (N - 5)}, "line 5, column 'x'"),
    "text": (lambda: good() | {"x": ["a"] * N}, "column 'x': expected a column of numbers, found string"),
    "time that repeats": (repeated, "line 2, column 't': time repeats"),
    "zero quaternions": (lambda: good() | {f"q{k}": np.zeros(N) for k in "xyzw"}, "zero quaternion"),
    "no rows": (lambda: {key: value[:0] for key, value in good().items()}, "holds no rows"),
}


@pytest.mark.parametrize("case", COLUMNS)
def test_parquet_with_wrong_columns_is_refused(case, tmp_path):
    pq, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    make, words = COLUMNS[case]
    pq.write_table(pa.table(make()), tmp_path / "survey.parquet")
    assert words in refusal(tmp_path / "survey.parquet")


def test_parquet_with_two_columns_of_one_name_is_refused(tmp_path):
    pq, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    table = pa.table(good())
    pq.write_table(table.append_column("bx", table["bx"]), tmp_path / "survey.parquet")
    assert "column 'bx': the column appears 2 times" in refusal(tmp_path / "survey.parquet")


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.9, 0.99])
def test_parquet_cut_off_is_refused(share, tmp_path):
    pq, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    path = tmp_path / "survey.parquet"
    pq.write_table(pa.table(good()), path)
    raw = path.read_bytes()
    path.write_bytes(raw[: max(4, int(share * len(raw)))])
    assert "is a damaged Parquet file" in refusal(path)


# --- Phones --------------------------------------------------------------------------------------------------------

HEADER = "time,seconds_elapsed,z,y,x"


def rows(n=N, start=1_700_000_000_000_000_000):
    return [f"{start + i * 10_000_000},{i / 100},-45,3,{20 + i / 10}" for i in range(n)]


def logger(*lines, header=HEADER):
    return "\n".join([header, *(lines or rows()), ""])


@pytest.fixture
def poses(tmp_path):
    times = 1.7e9 + np.linspace(-1, 1, 30)
    write_tum(
        tmp_path / "poses.tum",
        times,
        np.random.default_rng(0).uniform(0, 1, (30, 3)),
        np.tile([0, 0, 0, 1.0], (30, 1)),
    )
    return tmp_path / "poses.tum"


LOGGERS = {
    "NaN": (logger(*rows(3), "1700000001000000000,2,nan,3,4"), "column 'z': expected a finite number"),
    "no z": (logger(header="time,seconds_elapsed,a,y,x"), "missing z"),
    "no time": (logger(header="a,seconds_elapsed,z,y,x"), "missing t"),
    "a clock set back": (logger(*rows(3), *rows(3, start=1_699_999_990_000_000_000)), "line 5: time runs backward"),
    "another clock": (logger(*rows(start=5)), "both need the same clock"),
    "phyphox with commas and points": (
        'Time (s);"Magnetic field x (µT)";"Magnetic field y (µT)";"Magnetic field z (µT)"\n0,1;2.5;3,0;4,0\n',
        "with a point",
    ),
    "phyphox without z": (
        '"Time (s)","Magnetic field x (µT)","Magnetic field y (µT)"\n0,1,2\n',
        "missing magnetic field z",
    ),
}


@pytest.mark.parametrize("case", LOGGERS)
def test_a_phone_table_at_fault_is_named_by_line(case, poses, tmp_path):
    content, words = LOGGERS[case]
    (tmp_path / "Magnetometer.csv").write_text(content)
    assert words in refusal(tmp_path / "Magnetometer.csv", trajectory=poses)


def test_uncalibrated_samples_are_read_last_and_said_to_be(poses, tmp_path, zipped, caplog):
    both = {"Magnetometer.csv": logger(), "MagnetometerUncalibrated.csv": logger()}
    read_survey(zipped(tmp_path / "a.zip", both), SurveyFormat(trajectory=poses))
    assert "calibration" not in caplog.text
    del both["Magnetometer.csv"]
    read_survey(zipped(tmp_path / "b.zip", both), SurveyFormat(trajectory=poses))
    assert "without the phone's own calibration" in caplog.text


def test_a_phone_log_alone_says_where_positions_come_from(tmp_path, zipped):
    tables = dict.fromkeys(("Magnetometer.csv", "TotalAcceleration.csv", "Gyroscope.csv"), logger())
    said = refusal(zipped(tmp_path / "all.zip", tables))
    assert "--trajectory POSES.tum ('magmatch odometry' makes one where" in said


@pytest.mark.parametrize(
    ("tables", "folders"),
    [
        (("a/Magnetometer.csv", "b/Magnetometer.csv"), "a, b"),
        (("Magnetometer.csv", "a/b/Gyroscope.csv"), "(top), a/b"),
    ],
)
def test_tables_in_several_folders_of_an_archive_are_refused(tables, folders, poses, tmp_path, zipped):
    path = zipped(tmp_path / "bulk.zip", dict.fromkeys(tables, logger()))
    assert f"in 2 folders ({folders}): several logs? Unpack it" in refusal(path, trajectory=poses)


def test_an_encrypted_archive_is_refused(poses, tmp_path, zipped):
    path = zipped(tmp_path / "export.zip", {"Magnetometer.csv": logger()})
    raw = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        raw[raw.index(signature) + offset] |= 1
    path.write_bytes(raw)
    assert "encrypted" in refusal(path, trajectory=poses)


def test_an_archive_with_a_damaged_member_is_refused(poses, tmp_path, zipped):
    path = zipped(tmp_path / "export.zip", {"Magnetometer.csv": logger()})
    raw = bytearray(path.read_bytes())
    raw[60:90] = bytes(30)
    path.write_bytes(raw)
    assert "damaged zip archive" in refusal(path, trajectory=poses)


def test_an_archive_that_lies_about_its_size_is_refused(poses, tmp_path, zipped):
    path = zipped(tmp_path / "export.zip", {"Magnetometer.csv": logger()})
    raw = bytearray(path.read_bytes())
    start = raw.index(b"PK\x01\x02") + 24
    raw[start : start + 4] = (40).to_bytes(4, "little")
    path.write_bytes(raw)
    refusal(path, trajectory=poses)


def test_folders_and_links_in_place_of_files_are_refused(poses, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "Magnetometer.csv").mkdir()
    assert "is a folder" in refusal(tmp_path / "a", trajectory=poses)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "Magnetometer.csv").symlink_to("Magnetometer.csv")
    refusal(tmp_path / "b", trajectory=poses)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "Magnetometer.csv").symlink_to(os.devnull)
    assert "not a regular file" in refusal(tmp_path / "c", trajectory=poses)


# --- EuRoC ---------------------------------------------------------------------------------------------------------

EUROC = {
    "whole seconds with a point": ("1.5,1,2,3\n2.5,1,2,3", "expected whole nanoseconds, found '1.5'"),
    "stamps of twenty digits": ("12345678901234567890,1,2,3", "expected whole nanoseconds"),
    "stamps too close for seconds": ("1700000000000000000,1,2,3\n1700000000000000010,1,2,3", "time repeats"),
    "two columns": ("5,1\n6,1", "expected rows of t, bx, by, bz"),
    "NaN": ("1700000000000000000,1,nan,3", "line 2, column 'by'"),
}


@pytest.mark.parametrize("case", EUROC)
def test_a_euroc_file_at_fault_is_named_by_line(case, poses, tmp_path):
    content, words = EUROC[case]
    (tmp_path / "mag.csv").write_text("#timestamp [ns],x [uT],y [uT],z [uT]\n" + content + "\n")
    assert words in refusal(tmp_path / "mag.csv", trajectory=poses)


OTHER_KINDS = {
    "log.mcap": (b"\x89MCAP0\r\n", "expected a trajectory"),
    "survey.parquet": (b"PAR1", "expected a trajectory"),
    "map.png": (b"\x89PNG\r\n\x1a\n", "PNG picture"),
    "result.json": (b'{"schema": "magmatch.registration/1"}', "a registration file"),
    "export.zip": (None, "expected a trajectory"),
}


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_a_trajectory_of_another_kind_is_named(kind, tmp_path, zipped):
    content, words = OTHER_KINDS[kind]
    if content is None:
        zipped(tmp_path / kind, {"Magnetometer.csv": logger()})
    else:
        (tmp_path / kind).write_bytes(content)
    (tmp_path / "field.csv").write_text("t,bx,by,bz\n0,1,2,3\n")
    assert words in refusal(tmp_path / "field.csv", trajectory=tmp_path / kind)
