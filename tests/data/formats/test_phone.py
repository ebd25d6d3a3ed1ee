# SPDX-License-Identifier: BSD-3-Clause
"""Phone logs: the tables of Sensor Logger and phyphox, alone, in a folder or in a zip archive."""

import zipfile

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.tables.tum import write_tum
from magmatch.errors import DataFormatError

N = 40
FIELD_UT = np.random.default_rng(1).normal([18.0, 3.0, -45.0], 2.0, (N, 3))


def sensor_logger(start_ns=1_700_000_000_000_000_000):
    """Its columns stand in the order z, y, x."""
    rows = [
        f"{start_ns + i * 10_000_000},{0.01 * i},{z!r},{y!r},{x!r}" for i, (x, y, z) in enumerate(FIELD_UT.tolist())
    ]
    return "\n".join(["time,seconds_elapsed,z,y,x", *rows, ""])


@pytest.fixture
def poses(tmp_path):
    """Walks along x at 1 m/s without turning, on either clock."""

    def write(start):
        times = start + np.linspace(-0.1, 0.6, 30)
        positions = np.column_stack([times - start, 0.01 * np.sin(9 * times), 0 * times])
        write_tum(tmp_path / "poses.tum", times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (30, 1)))
        return SurveyFormat(trajectory=tmp_path / "poses.tum")

    return write


def zipped(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in members.items():
            archive.writestr(name.replace("__", "/").replace("_", " ") + ".csv", text)
    return path


def test_sensor_logger_in_every_wrapping_gives_the_same_survey(tmp_path, poses):
    layout = poses(1.7e9)
    (tmp_path / "table.csv").write_text(sensor_logger())
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "Magnetometer.csv").write_text(sensor_logger())
    (tmp_path / "export" / "Location.csv").write_text("time,latitude\n")
    zipped(tmp_path / "export.zip", **{"walk__Magnetometer": sensor_logger(), "walk__Location": "time,latitude\n"})
    for name in ("table.csv", "export", "export.zip"):
        survey = read_survey(tmp_path / name, layout)
        np.testing.assert_array_equal(survey.field, FIELD_UT * 1e-6)
        np.testing.assert_allclose(survey.positions[:, 0], 0.01 * np.arange(N), atol=1e-6)  # clock of 0.24 us


def test_uncalibrated_samples_are_read_last_and_said_to_be(tmp_path, poses, caplog):
    other = sensor_logger().replace("time,", "time,", 1)
    path = zipped(tmp_path / "a.zip", Magnetometer=other, MagnetometerUncalibrated=other)
    read_survey(path, poses(1.7e9))
    assert "calibration" not in caplog.text
    read_survey(zipped(tmp_path / "b.zip", MagnetometerUncalibrated=other), poses(1.7e9))
    assert "without the phone's own calibration" in caplog.text


def test_a_phone_log_alone_says_where_positions_come_from(tmp_path):
    (tmp_path / "table.csv").write_text(sensor_logger())
    with pytest.raises(DataFormatError, match=r"--trajectory POSES\.tum$"):  # no odometry: nothing to make it of
        read_survey(tmp_path / "table.csv")
    tables = {"Magnetometer": sensor_logger(), "TotalAcceleration": sensor_logger(), "Gyroscope": sensor_logger()}
    with pytest.raises(DataFormatError, match=r"'magmatch odometry' makes one"):
        read_survey(zipped(tmp_path / "all.zip", **tables))


@pytest.mark.parametrize("tables", [("a__Magnetometer", "b__Magnetometer"), ("Magnetometer", "a__b__Gyroscope")])
def test_tables_in_several_folders_of_an_archive_are_refused(tables, tmp_path, poses):
    path = zipped(tmp_path / "bulk.zip", **dict.fromkeys(tables, sensor_logger()))
    folders = {"a__Magnetometer": r"a, b", "Magnetometer": r"\(top\), a/b"}[tables[0]]
    with pytest.raises(DataFormatError, match=rf"in 2 folders \({folders}\): several logs\? Unpack it"):
        read_survey(path, poses(1.7e9))
