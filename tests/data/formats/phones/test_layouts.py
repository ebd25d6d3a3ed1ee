# SPDX-License-Identifier: BSD-3-Clause
"""What the apps for phones write, made up: every layout of one walk gives the same readings."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from magmatch.data.formats.phones.phone_log import STANDARD_GRAVITY
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.formats.sniff import sniff
from magmatch.errors import DataFormatError

N = 30
RNG = np.random.default_rng(2)
READINGS = {
    "field": RNG.normal([18, 3, -45], 2, (N, 3)).round(4),  # uT
    "acceleration": RNG.normal([0, 6, 7.7], 0.3, (N, 3)).round(4),
    "rate": RNG.normal(0, 0.2, (N, 3)).round(4),
}
TIMES = 0.02 * np.arange(N)
UNITS = {"field": "µT", "acceleration": "m/s^2", "rate": "rad/s"}
NAMES = {"field": "Magnetometer", "acceleration": "Accelerometer", "rate": "Gyroscope"}
LONG = {"field": "Magnetic field", "acceleration": "Acceleration", "rate": "Gyroscope"}
TOTAL = {"field": "Magnetometer", "acceleration": "TotalAcceleration", "rate": "Gyroscope"}


def rows(names, columns, mark=",", decimal="."):
    """A table with quoted names."""
    cells = [mark.join(repr(float(v)).replace(".", decimal) for v in row) for row in np.column_stack(columns)]
    return "\n".join([mark.join(f'"{name}"' for name in names), *cells, ""])


def phyphox(sensor, mark=",", decimal=".", *, is_long=False):
    axes = [f"{LONG[sensor]} {a} ({UNITS[sensor]})" if is_long else f"{a.upper()} ({UNITS[sensor]})" for a in "xyz"]
    return rows(["Time (s)", *axes], [TIMES, READINGS[sensor]], mark, decimal)


def sensor_logger(values, start=1_700_000_000_000_000_000):
    lines = [f"{start + 20_000_000 * i},{0.02 * i},{z},{y},{x}" for i, (x, y, z) in enumerate(values.tolist())]
    return "\n".join(["time,seconds_elapsed,z,y,x", *lines, ""])


def getsensordata(jitter=0.0, *, ahead=-65000.5):
    tags = {"field": "MAGN", "acceleration": "ACCE", "rate": "GYRO"}
    lines = ["% LogFile created by the 'GetSensorData' App for Android.", "% Phone: Größe", "%", "stray text", ""]
    for i, t in enumerate(TIMES):
        # The app's clock comes in bursts, late by up to the jitter; half of the rows are on time.
        late = jitter * (i % 4 == 3)
        for sensor, tag in tags.items():
            numbers = ";".join(map(str, READINGS[sensor][i]))
            lines.append(f"{tag};{t + late:.4f};{t - ahead:.4f};{numbers};3")
        lines.append(f"AHRS;{t:.4f};{t - ahead:.4f};1;2;3;0;0;0;3")
    return "\n".join([*lines, "POSI;0.1;1;49.0;11.0;0;100", ""]).encode("latin-1")


def android(*, unit=1e9, tags=("2", "1", "4"), header="event.timestamp,event.sensor,x,y,z"):
    lines = [header]
    for i, t in enumerate(TIMES):
        for tag, values in zip(tags, READINGS.values(), strict=True):
            lines.append(",".join([repr(round(5e4 * unit) + round(t * unit)), tag, *map(str, values[i])]))
    return "\n".join([*lines, ""])


def filled(path, members):
    path.mkdir()
    for name, text in members.items():
        (path / name).write_text(text)
    return path


def assert_same(log, start=0.0, tolerance=1e-6):
    assert set(log.streams) == set(READINGS)
    for sensor, values in READINGS.items():
        scale = 1e-6 if sensor == "field" else 1.0
        np.testing.assert_allclose(log.streams[sensor].values, scale * values, rtol=1e-12)
        np.testing.assert_allclose(log.streams[sensor].times - start, TIMES, atol=tolerance)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.parametrize("is_long", [True, False])
def test_phyphox_in_every_layout_gives_the_same_readings(mark, decimal, is_long, tmp_path, zipped):
    if mark == decimal:
        return  # which the app does not offer
    tables = {f"{NAMES[s]}.csv": phyphox(s, mark, decimal, is_long=is_long) for s in READINGS}
    beside = {"meta/device.csv": "property,value\n", "meta/time.csv": '"event","experiment time"\n"START",0\n'}
    for path in (zipped(tmp_path / "walk.zip", tables | beside), filled(tmp_path / "walk", tables)):
        assert sniff(path) == "phone"
        log = read_phone_log(path)
        assert log.app == "phyphox"
        assert_same(log)


def test_one_phyphox_table_of_several_sensors_may_have_holes(tmp_path, zipped):
    names = ["Time (s)", *(f"{LONG[s]} {a} ({UNITS[s]})" for s in READINGS for a in "xyz")]
    values = np.column_stack(list(READINGS.values()))
    text = rows(names, [TIMES, values])
    assert_same(read_phone_log(zipped(tmp_path / "a.zip", {"Raw Data.csv": text})))
    lines = text.split("\n")
    cells = lines[5].split(",")
    lines[5] = ",".join([*cells[:7], "NaN", "NaN", "NaN"])
    log = read_phone_log(zipped(tmp_path / "b.zip", {"Raw Data.csv": "\n".join(lines)}))
    assert [len(log.streams[s]) for s in READINGS] == [N, N, N - 1]


LANGUAGES = {
    "German": ("Zeit", "Magnetfeld", "Beschleunigung", "Gyroskop", "Lineare Beschleunigung"),
    "French": ("Temps", "Champ magnétique", "Accélération", "Gyroscope", "Accélération linéaire"),
    "Chinese": ("时间", "磁场", "加速度", "陀螺仪", None),
}


@pytest.mark.parametrize("language", LANGUAGES)
def test_phyphox_may_write_in_other_languages(language, tmp_path, zipped):
    time, *words, linear = LANGUAGES[language]
    kinds = [(word, UNITS[sensor], values) for word, (sensor, values) in zip(words, READINGS.items(), strict=True)]
    kinds += [(linear, "m/s^2", READINGS["acceleration"] - 1)] if linear else []
    tables = {
        f"{word}.csv": rows([f"{time} (s)", *(f"{word} {a} ({unit})" for a in "xyz")], [TIMES, values], ";", ",")
        for word, unit, values in kinds
    }
    log = read_phone_log(zipped(tmp_path / "walk.zip", tables))
    assert log.app == "phyphox"
    assert ("linear_acceleration" in log.streams) is bool(linear)
    assert_same(replace(log, streams={sensor: log.streams[sensor] for sensor in READINGS}))
    for name, text in tables.items():
        (tmp_path / name).write_text(text)
        assert sniff(tmp_path / name) == "phone"


def test_a_survey_in_another_language_is_no_phone(tmp_path):
    (tmp_path / "walk.csv").write_text("Zeit (s),x (m),y (m),z (m),B x (µT),B y (µT),B z (µT)\n0,1,2,3,20,1,-40\n")
    assert sniff(tmp_path / "walk.csv") == "csv"


def androsensor(kinds=("ACCELEROMETER", "GRAVITY", "LINEAR ACCELERATION"), mark=";", clock="Time since start in ms "):
    """One table of all sensors, with what the app writes beside them."""
    still, down = np.zeros((N, 3)), np.array([0, 0, STANDARD_GRAVITY])
    columns = {
        "ACCELEROMETER": ("m/s²", READINGS["acceleration"]),
        "GRAVITY": ("m/s²", still + down),
        "LINEAR ACCELERATION": ("m/s²", READINGS["acceleration"] - down),
        "GYROSCOPE": ("rad/s", READINGS["rate"]),
        "MAGNETIC FIELD": ("μT", READINGS["field"]),
    }
    used = [name for name in columns if name in (*kinds, "GYROSCOPE", "MAGNETIC FIELD")]
    names = [f"{name} {axis} ({columns[name][0]})" for name in used for axis in "XYZ"]
    names += ["ORIENTATION Z (azimuth °)", "LOCATION Latitude : ", "Satellites in range"]
    names += [clock, "YYYY-MO-DD HH-MI-SS_SSS"]
    lines = [mark.join(names)]
    for i, values in enumerate(np.hstack([columns[name][1] for name in used]).tolist()):
        lines.append(
            mark.join([*map(repr, values), "12.5", "48.1", "7 / 9", f"{20 * i}", f"2026-05-01 10:00:00:{i}"])
        )
    return "\n".join([*lines, ""])


@pytest.mark.parametrize("clock", ["Time since start in ms ", "TIME SINCE START (ms)"])
@pytest.mark.parametrize("mark", [";", ",", ", "])
def test_androsensor_is_read_whole(mark, clock, tmp_path):
    (tmp_path / "Sensor_record.csv").write_text(androsensor(mark=mark, clock=clock))
    assert sniff(tmp_path / "Sensor_record.csv") == "phone"
    log = read_phone_log(tmp_path / "Sensor_record.csv")
    assert log.app == "AndroSensor"
    assert set(log.streams) == {*READINGS, "gravity", "linear_acceleration"}
    assert_same(replace(log, streams={sensor: log.streams[sensor] for sensor in READINGS}))


def test_androsensor_without_the_accelerometer_has_the_sum_of_its_parts(tmp_path):
    (tmp_path / "record.csv").write_text(androsensor(("GRAVITY", "LINEAR ACCELERATION")))
    sums = read_phone_log(tmp_path / "record.csv").acceleration("a test").values
    np.testing.assert_allclose(sums, READINGS["acceleration"], atol=1e-9)


def test_sensor_logger_is_read_whole(tmp_path, zipped):
    tables = {f"{TOTAL[s]}.csv": sensor_logger(values) for s, values in READINGS.items()}
    beside = {"Orientation.csv": "time,seconds_elapsed,yaw,qx,qz,roll,qw,qy,pitch\n", "Metadata.csv": "version\n1\n"}
    for path in (zipped(tmp_path / "walk.zip", tables | beside), filled(tmp_path / "walk", tables | beside)):
        assert_same(read_phone_log(path), 1.7e9)


@pytest.mark.parametrize("unit", [1.0, STANDARD_GRAVITY])
def test_gravity_is_added_where_the_app_took_it_off_and_multiples_of_g_are_known(unit, tmp_path, zipped):
    gravity = np.array([0, 6, 7.7])
    whole = READINGS["acceleration"]
    linear = (whole - gravity) / unit
    tables = {"Accelerometer.csv": sensor_logger(linear), "Gravity.csv": sensor_logger(0 * whole + gravity / unit)}
    log = read_phone_log(zipped(tmp_path / "walk.zip", tables))
    np.testing.assert_allclose(log.acceleration("a test").values, whole, atol=1e-9)
    alone = read_phone_log(zipped(tmp_path / "alone.zip", {"Accelerometer.csv": tables["Accelerometer.csv"]}))
    with pytest.raises(DataFormatError, match="expected accelerations with gravity"):
        alone.acceleration("a test")


def test_raw_and_calibrated_magnetometer_are_told_apart(tmp_path, zipped):
    raw = READINGS["field"] + 100
    tables = {
        "Magnetometer.csv": sensor_logger(READINGS["field"]),
        "MagnetometerUncalibrated.csv": sensor_logger(raw),
    }
    log = read_phone_log(zipped(tmp_path / "walk.zip", tables))
    np.testing.assert_allclose(log.streams["raw_field"].values - log.streams["field"].values, 100e-6)
    text = android(tags=("android.sensor.magnetic_field_uncalibrated", "1", "android.sensor.magnetic_field"))
    (tmp_path / "android.csv").write_text(text)
    assert set(read_phone_log(tmp_path / "android.csv").streams) == {"raw_field", "acceleration", "field"}


@pytest.mark.parametrize("wrap", [bytes, gzip.compress])
def test_getsensordata_is_read_on_the_clock_of_the_app_without_its_jitter(wrap, tmp_path):
    (tmp_path / "log.txt").write_bytes(wrap(getsensordata(jitter=0.5)))
    assert sniff(tmp_path / "log.txt") == "phone"
    log = read_phone_log(tmp_path / "log.txt")
    assert log.app == "GetSensorData"
    assert_same(log)


def test_times_of_getsensordata_do_not_depend_on_what_is_asked_for(tmp_path):
    (tmp_path / "log.txt").write_bytes(getsensordata(jitter=0.5))
    whole, part = (read_phone_log(tmp_path / "log.txt", *wanted) for wanted in ((), (("field",),)))
    np.testing.assert_array_equal(whole.streams["field"].times, part.streams["field"].times)


@pytest.mark.parametrize("unit", [1e9, 1e6, 1e3])
@pytest.mark.parametrize("tags", [("2", "1", "4"), ("Magnetometer", "ACCELEROMETER", "gyroscope")])
def test_android_rows_are_sorted_by_sensor_and_their_unit_of_time_is_told(unit, tags, tmp_path):
    for header in ("event.timestamp,event.sensor,x,y,z", "event.timestamp,sensor,event.values[0],values[1],value_2"):
        (tmp_path / "log.csv").write_text(android(unit=unit, tags=tags, header=header))
        assert sniff(tmp_path / "log.csv") == "phone"
        assert_same(read_phone_log(tmp_path / "log.csv"), 5e4)


def test_android_tables_of_one_sensor_each_are_told_by_their_names(tmp_path, zipped):
    tables = {}
    for sensor, values in READINGS.items():
        columns = ["event.timestamp", *(f"event.values[{k}]" for k in range(3)), "event.accuracy"]
        tables[f"{NAMES[sensor]}.csv"] = rows(columns, [1e9 * TIMES, values, 0 * TIMES])
    assert_same(read_phone_log(zipped(tmp_path / "walk.zip", tables)))


def test_rows_that_stand_out_of_order_are_sorted_and_counted(tmp_path, caplog):
    lines = sensor_logger(READINGS["field"]).split("\n")
    lines[4], lines[5] = lines[5], lines[4]
    lines.insert(8, lines[8])
    (tmp_path / "Magnetometer.csv").write_text("\n".join(lines))
    log = read_phone_log(tmp_path / "Magnetometer.csv")
    np.testing.assert_allclose(log.streams["field"].values, 1e-6 * READINGS["field"])
    assert "1 stand after later ones (sorted) and 1 repeat a time" in caplog.text
