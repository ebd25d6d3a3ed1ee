# SPDX-License-Identifier: BSD-3-Clause
"""What an export says beside its readings counts: pauses of phyphox, and the signs of Sensor Logger on iPhones."""

import numpy as np
import pytest

from magmatch.data.formats.phones.read import read_phone_log

TIMES = np.arange(0, 6, 0.5)
EVENTS = {"one pause": [(2.0, 60.0)], "two pauses": [(2.0, 60.0), (4.25, 0.5)], "no pause": []}


def about_time(pauses, mark=",", decimal=".", start=1.7e9):
    """A time.csv of phyphox."""
    rows, behind = [("START", 0.0, start)], 0.0
    for at, length in pauses:
        rows += [("PAUSE", at, start + at + behind), ("START", at, start + at + behind + length), ("NOTE", at, 0.0)]
        behind += length
    rows.append(("PAUSE", 6.0, start + 6 + behind))
    head = mark.join(f'"{name}"' for name in ("event", "experiment time", "system time", "system time text"))
    lines = [mark.join([f'"{event}"', f"{at:.9E}", f"{clock:.3f}", '"x"']) for event, at, clock in rows]
    return "\n".join([head, *(line.replace(".", decimal) for line in lines), ""])


def export(path, about, name="meta/time.csv", app="phyphox", zipped=None):
    """A folder, or an archive with a folder in it."""
    head = 'Time (s),"Magnetic field x (µT)","Magnetic field y (µT)","Magnetic field z (µT)"'
    table = "\n".join([head, *(f"{t},{i},2,-45" for i, t in enumerate(TIMES)), ""])
    members = {"Magnetometer.csv": table}
    if app == "Sensor Logger":
        rows = [f"{1_700_000_000_000_000_000 + int(1e9 * t)},{t},1,2,9.5" for t in TIMES]
        sensors = ("Magnetometer", "TotalAcceleration", "Gravity", "Accelerometer", "Gyroscope")
        members = {f"{sensor}.csv": "\n".join(["time,seconds_elapsed,x,y,z", *rows, ""]) for sensor in sensors}
    if about is not None:
        members[name] = about
    if path.suffix == ".zip":
        return zipped(path, {f"walk 1/{member}": text for member, text in members.items()})
    for member, text in members.items():
        (path / member).parent.mkdir(parents=True, exist_ok=True)
        (path / member).write_text(text)
    return path


@pytest.mark.parametrize("case", EVENTS)
@pytest.mark.parametrize("name", ["phone", "phone.zip"])
def test_what_follows_a_pause_is_moved_by_it(name, case, tmp_path, zipped, caplog):
    pauses = EVENTS[case]
    log = read_phone_log(export(tmp_path / name, about_time(pauses), zipped=zipped))
    expected = TIMES + sum((length * (at <= TIMES) for at, length in pauses), np.zeros(len(TIMES)))
    np.testing.assert_allclose(log.streams["field"].times, expected, rtol=0, atol=1e-6)
    said = ", ".join(f"{length:g} s at {at:g} s" for at, length in pauses)
    assert (f"was paused ({said})" in caplog.text) == bool(pauses)


@pytest.mark.parametrize(("mark", "decimal"), [(";", ","), ("\t", ".")])
def test_metadata_may_have_decimal_commas(mark, decimal, tmp_path):
    log = read_phone_log(export(tmp_path / "phone", about_time([(2.0, 60.0)], mark, decimal)))
    assert log.streams["field"].times[-1] == pytest.approx(65.5)


@pytest.mark.parametrize("about", ["", "event\nSTART\n", about_time([(2.0, np.nan)]), "\0", None])
def test_metadata_that_cannot_be_read_leaves_the_times_as_they_are(about, tmp_path):
    log = read_phone_log(export(tmp_path / "phone", about))
    np.testing.assert_array_equal(log.streams["field"].times, TIMES)


def test_a_clock_set_back_in_a_pause_is_said_and_moves_nothing(tmp_path, caplog):
    log = read_phone_log(export(tmp_path / "phone", about_time([(2.0, -60.0)])))
    np.testing.assert_array_equal(log.streams["field"].times, TIMES)
    assert "was paused (-60 s at 2 s), while the phone's clock was set back" in caplog.text


HEAD = "version,device name,platform,standardisation"


@pytest.mark.parametrize(
    ("about", "sign"),
    [
        (f"{HEAD}\n3,x,ios,false\n", -1),
        ("version,platform\n1,iOS\n", -1),
        (f"{HEAD}\n3,x,ios,true\n", 1),
        (f"{HEAD}\n3,x,android,false\n", 1),
        (None, 1),
    ],
)
def test_accelerations_of_iphones_are_turned_to_androids_signs(about, sign, tmp_path):
    log = read_phone_log(export(tmp_path / "phone", about, "Metadata.csv", "Sensor Logger"))
    for sensor in ("acceleration", "gravity", "linear_acceleration"):
        np.testing.assert_array_equal(log.streams[sensor].values[0], [sign * 1.0, sign * 2.0, sign * 9.5])
    np.testing.assert_array_equal(log.streams["rate"].values[0], [1.0, 2.0, 9.5])
    np.testing.assert_allclose(log.streams["field"].values[0], [1e-6, 2e-6, 9.5e-6])
