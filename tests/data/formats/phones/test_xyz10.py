# SPDX-License-Identifier: BSD-3-Clause
"""Logs of XYZ10's competition: rows of tagged sensors, and points that the walker marked."""

import gzip

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.phones.phone_log import WORDS
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.formats.sniff import sniff
from magmatch.data.read import read_raw_magnetometer, read_survey
from magmatch.data.tables.tum import write_tum
from magmatch.errors import DataFormatError
from magmatch.preparation.odometry.open_walk import open_walk

N, START = 30, 1_574_568_614_840  # Unix ms
RNG = np.random.default_rng(3)
FIELD, FELT, TURN = (RNG.normal(mean, 1, (N, 3)).round(4) for mean in ([18, 3, -45], [0, 6, 7.7], [0, 0, 0]))
BIAS = [-64.0, -14.0, -350.0]
HEADER = "#\tstartTime:1574568614708\n#\tSiteName:\u676d\u5dde\tFloorName:F2\n#\ttype:1\tname:BMI160\n"


def joined(*cells):
    return "\t".join(map(str, cells))


def rows():
    yield joined(START - 125, "TYPE_WAYPOINT", 77.79517, 127.669235)
    for k in range(N):
        t = START + 20 * k
        yield joined(t, "TYPE_ACCELEROMETER", *FELT[k], 2)
        yield joined(t, "TYPE_MAGNETIC_FIELD", *FIELD[k], 3)
        yield joined(t, "TYPE_GYROSCOPE", *TURN[k], 3)
        yield joined(t, "TYPE_ROTATION_VECTOR", 0.1, 0.2, -0.4, 3)
        yield joined(t, "TYPE_MAGNETIC_FIELD_UNCALIBRATED", *(FIELD[k] + BIAS), *BIAS, 3)
        yield joined(t, "TYPE_WIFI", "ssid", "bssid", -50, 5200, t)
    yield joined(START + 300, "TYPE_WAYPOINT", 81.3263, 130.23949)  # late, as the app writes it


def text():
    return HEADER + "\n".join(rows()) + "\n#\tendTime:1574568617943\n"


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_text(text())
    return path


def test_each_sensor_is_read_in_our_units_whether_packed_quoted_or_with_other_line_ends(tmp_path, log):
    (tmp_path / "packed").write_bytes(gzip.compress(text().encode()))
    (tmp_path / "dos.txt").write_bytes(text().replace("\n", "\r\n").encode())
    (tmp_path / "quoted.txt").write_text(text().replace(f"{FIELD[3, 0]}", f'"{FIELD[3, 0]}"'))
    for path in (log, tmp_path / "packed", tmp_path / "dos.txt", tmp_path / "quoted.txt"):
        assert sniff(path) == "phone"
        read = read_phone_log(path)
        assert read.app == "XYZ10"
        want = {"field": FIELD * 1e-6, "raw_field": (FIELD + BIAS) * 1e-6, "acceleration": FELT, "rate": TURN}
        assert read.streams.keys() == want.keys()
        for sensor, values in want.items():
            np.testing.assert_allclose(read.streams[sensor].values, values, rtol=0, atol=1e-12, err_msg=sensor)
            np.testing.assert_allclose(read.streams[sensor].times, (START + 20 * np.arange(N)) / 1e3, rtol=1e-15)
        assert read.points is None  # nobody asked


def test_its_waypoints_are_points_of_the_plan(log):
    points = read_phone_log(log, ("field",), with_points=True).points
    np.testing.assert_allclose(points.times, [START / 1e3 - 0.125, START / 1e3 + 0.3], rtol=1e-15)
    np.testing.assert_array_equal(points.places, [[77.79517, 127.669235], [81.3263, 130.23949]])
    assert not points.in_degrees
    assert points.floors == ("F2",)
    assert points.lines[0] == HEADER.count("\n") + 1


def test_rows_that_lost_their_line_end_are_read(tmp_path, log):
    whole = read_phone_log(log, with_points=True)
    broken = text()
    for tag in ("TYPE_GYROSCOPE", "TYPE_MAGNETIC_FIELD\t", "TYPE_ACCELEROMETER"):
        at = broken.index(tag, len(broken) // 3)
        end = broken.rindex("\n", 0, at)
        broken = broken[:end] + broken[end + 1 :]
    first = broken.index("\n", broken.index("TYPE_WAYPOINT"))
    broken = broken[:first] + broken[first + 1 :]
    (tmp_path / "broken.txt").write_text(broken)
    read = read_phone_log(tmp_path / "broken.txt", with_points=True)
    for sensor, stream in whole.streams.items():
        np.testing.assert_array_equal(read.streams[sensor].values, stream.values, err_msg=WORDS[sensor])
    np.testing.assert_array_equal(read.points.places, whole.points.places)


def test_with_a_trajectory_it_is_a_survey_in_either_calibration(tmp_path, log):
    times = START / 1e3 + np.linspace(-0.1, 0.8, 40)
    positions = np.column_stack([times - times[0], np.sin(times), 0 * times])
    write_tum(tmp_path / "poses.tum", times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (40, 1)))
    layout = SurveyFormat(trajectory=tmp_path / "poses.tum")
    survey = read_survey(log, layout)
    np.testing.assert_allclose(survey.field, FIELD * 1e-6, atol=1e-15)
    np.testing.assert_array_equal(survey.waypoints.places[0], [77.79517, 127.669235])
    # As of other phones: left aside where hard iron makes it impossible, not refused.
    read_raw_magnetometer(log, layout)


def test_a_waypoint_that_cannot_be_is_no_fault_of_a_survey(tmp_path, log, caplog):
    poses = tmp_path / "poses.tum"
    write_tum(poses, START / 1e3 + np.array([-1.0, 9]), np.eye(2, 3), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    log.write_text(f"{text()}1574568614860\tTYPE_WAYPOINT\t1\n")
    survey = read_survey(log, SurveyFormat(trajectory=poses))
    assert len(survey) == N
    assert survey.waypoints is None
    assert "expected 4 cells (sensor, time, x, y), found 3; " in caplog.text
    assert "(none of its surveyed points is read)" in caplog.text
    with pytest.raises(DataFormatError, match="found 3"):
        open_walk(log, SurveyFormat(trajectory=poses), with_points=True)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1574568614860\tTYPE_MAGNETIC_FIELD\t1\tup\t3\t3", "column 'y'"),
        ("1574568614860\tTYPE_MAGNETIC_FIELD\t1\t2", "expected 5 cells (sensor, time, x, y, z), found 4"),
        ("1574568614860\tTYPE_WAYPOINT\t1", "expected 4 cells (sensor, time, x, y), found 3"),
        ("1574568614860\tTYPE_WAYPOINT\t1\t1e12", "expected metres within"),
    ],
)
def test_a_row_that_cannot_be_is_named(tmp_path, row, said):
    path = tmp_path / "walk.txt"
    path.write_text(f"{text()}{row}\n")
    with pytest.raises(DataFormatError, match=f"line {text().count(chr(10)) + 1}") as error:
        read_phone_log(path, with_points=True)
    assert said in str(error.value)


def test_posi_rows_are_points_in_degrees_with_their_floors(tmp_path):
    lines = [
        "% GetSensorData",
        "MAGN;0;100;1;2;3;3",
        "POSI;0.5;1;49.4613;11.1109;0;100",
        "POSI;2;2;49.4614;11.11;1;100",
    ]
    (tmp_path / "log.txt").write_text("\n".join(lines))
    points = read_phone_log(tmp_path / "log.txt", with_points=True).points
    assert points.in_degrees
    assert (points.times.tolist(), points.floors) == ([0.5, 2.0], ("0", "1"))
    np.testing.assert_array_equal(points.places, [[49.4613, 11.1109], [49.4614, 11.11]])
    (tmp_path / "log.txt").write_text("\n".join([*lines, "POSI;3;3;149;11;1;100"]))
    read_phone_log(tmp_path / "log.txt")  # which reads no points
    with pytest.raises(DataFormatError, match=r"line 5.*latitude of 149"):
        read_phone_log(tmp_path / "log.txt", with_points=True)


def test_posi_rows_have_the_decimal_mark_of_their_log(tmp_path):
    rows = ["% GetSensorData", "MAGN;0.25;100.5;1.5;2;3;3", "POSI;0.5;1;49.4613;11.1109;0;100"]
    (tmp_path / "log.txt").write_text("\n".join(rows).replace(".", ","))
    points = read_phone_log(tmp_path / "log.txt", with_points=True).points
    assert points.times.tolist() == [0.5]
    np.testing.assert_array_equal(points.places, [[49.4613, 11.1109]])
