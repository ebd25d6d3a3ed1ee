# SPDX-License-Identifier: BSD-3-Clause
"""What no survey can be is refused; what is odd is said; what is ordinary passes in silence."""

import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.data.checks import check_survey, require_one_frame
from magmatch.data.describe import describe
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.data.sensor_axes import without_missing
from magmatch.data.survey import Survey
from magmatch.data.units import TESLA_PER_UNIT, likely_field_unit
from magmatch.errors import SurveyError


def test_ordinary_survey_passes_in_silence(room):
    assert check_survey(room) == []


def changed(survey, attribute, index, value):
    values = getattr(survey, attribute).copy()
    values[index] = value
    return replace(survey, **{attribute: values})


REFUSED = {
    "nine samples": (lambda s: s.subset(np.arange(9)), "at least 10 samples, found 9"),
    "spike": (lambda s: changed(s, "field", (8, 0), 0.2), "sample 8 is 200 mT, expected at most 100 mT"),
    "zero field": (lambda s: replace(s, field=0 * s.field), "every field value is zero"),
    "one point": (lambda s: replace(s, positions=0 * s.positions + 1), "one point"),
    "too large": (lambda s: replace(s, positions=1e6 * s.positions), "km, expected less than 100 km"),
    "origin elsewhere": (
        lambda s: replace(s, positions=s.positions + 5e6, frame="east, north, up of 11.6,48.1"),
        "8660 km from the origin 11.6,48.1, .*latitude and longitude swapped",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_impossible_survey_is_refused(name, room):
    change, words = REFUSED[name]
    with pytest.raises(SurveyError, match=f"room: .*{words}"):
        check_survey(change(room))


SAID = {
    "line": (lambda s: replace(s, positions=s.positions[:, :1] * [1.0, 2.0, 0.0]), "one line"),
    "tilted plane": (lambda s: replace(s, positions=s.positions @ tilted_plane()), "one plane"),
    "time gap": (lambda s: replace(s, times=s.times + 60 * (s.times > 10)), "1 gap, 60.5 s in all"),
    "standing still": (lambda s: replace(s, positions=np.repeat(s.positions[::5], 5, axis=0)), "repeat the position"),
    "stuck sensor": (lambda s: replace(s, field=np.repeat(s.field[::5], 5, axis=0)), "repeat the field"),
    "constant field": (lambda s: replace(s, field=0 * s.field + 30e-6), "field is constant"),
    "weak field": (lambda s: replace(s, field=s.field / 100), "unusual on Earth"),
    "strong field": (lambda s: replace(s, field=s.field * 100), "unusual on Earth"),
    "rows in teslas": (
        lambda s: replace(s, field=s.field * share(s, 1e-6)),
        "9 of 50 .* below 1 nT: rows in two units",
    ),
    "rows in nanoteslas": (
        lambda s: replace(s, field=s.field * share(s, 1e3)),
        "9 of 50 .* above 20 mT: rows in two units",
    ),
    "tiny": (lambda s: replace(s, positions=s.positions * 1e-4), "span only"),
    "huge": (lambda s: replace(s, positions=s.positions * 5e3, times=1e4 * s.times), "span 14.* km"),
    "milliseconds": (lambda s: replace(s, times=1e3 * s.times), "a sample every 500 s: are they in ms"),
    "microseconds": (lambda s: replace(s, times=1e6 * s.times), "a sample every 5e.05 s: are they in us"),
    "nanoseconds since 1970": (lambda s: replace(s, times=1.7e18 + 5e8 * s.times), "are they in ns"),
    "degrees": (
        lambda s: replace(s, positions=s.positions * [2e-3, 3e-3, 1.0] + [48.0, 11.0, 500.0]),
        "x and y hardly change around 48, 11.*: degrees",
    ),
    "too fast": (lambda s: replace(s, times=s.times / 100), "moves at .* m/s: wrong length unit"),
    "days": (lambda s: replace(s, times=s.times / 86400), "moves at .* m/s: are its times in days"),
    "two sensors": (
        lambda s: replace(s, positions=spiral(len(s)), orientations=None, field=s.field + 1e-5 * odd(len(s))),
        "goes to and fro by 17.* uT from sample to sample: two sensors",
    ),
}


def odd(n):
    """1 for every second sample."""
    return (np.arange(n) % 2)[:, None]


def spiral(n):
    angle = np.arange(n) / 5
    return np.column_stack([np.cos(angle), np.sin(angle), angle / 10])


def share(survey, factor, n=9):
    """A factor of the last rows."""
    return np.where(np.arange(len(survey)) < len(survey) - n, 1.0, factor)[:, None]


def tilted_plane():
    normal = np.array([1.0, -2.0, 2.0]) / 3
    return np.eye(3) - np.outer(normal, normal)


@pytest.mark.parametrize("name", SAID)
def test_odd_survey_is_said_but_not_refused(name, room):
    change, words = SAID[name]
    warnings = check_survey(change(room))
    assert len(warnings) == 1
    assert re.search(words, warnings[0]), warnings


def test_a_unit_of_times_that_is_stated_is_doubted_too(room):
    as_milliseconds = replace(room, times=1e3 * room.times)
    (said,) = check_survey(as_milliseconds, SurveyFormat(time_unit="ms"))
    assert "are they in us? (--time-unit us)" in said
    assert check_survey(room, SurveyFormat(time_unit="us")) == []
    since_boot = replace(room, times=2e3 + room.times)
    assert check_survey(since_boot, SurveyFormat(time_unit="ns")) == []


def test_a_survey_without_a_stated_frame_beside_one_about_an_origin_is_said(room, caplog):
    about = "east, north, up of 48.1,11.6"
    require_one_frame([room, replace(room, frame=about)])
    assert "room: taken to be in metres about 48.1,11.6, as another survey states" in caplog.text
    caplog.clear()
    require_one_frame([room, room])
    assert not caplog.text


MARKS = {
    "zero in all axes": (lambda b: np.zeros(3), "0, 0, 0"),
    "one number in all axes": (lambda b: np.full(3, -9.999e-3), "-10 mT"),
    "one axis beyond its range": (lambda b: np.array([b[0], b[1], -4.096e-3]), "-4.1 mT"),
}


@pytest.mark.parametrize("frame", ["survey", "sensor"])
@pytest.mark.parametrize("kind", MARKS)
def test_marks_of_missing_readings_are_left_out_and_told(room, tmp_path, caplog, kind, frame):
    mark, words = MARKS[kind]
    readings = room.orientations.apply(room.field, inverse=True) if frame == "sensor" else room.field
    rows = [3, 4, 17, 30]
    readings[rows] = [mark(b) for b in readings[rows]]
    path = tmp_path / "marked.csv"
    replace(room, field=readings).save(path)
    survey = read_survey(path, SurveyFormat(field_frame=frame))
    np.testing.assert_array_equal(survey.times, np.delete(room.times, rows))
    assert f"left out 4 of 50 samples that read {words}: marks of a missing reading" in caplog.text


@pytest.mark.parametrize("digit", [1e-9, 1e-6, 1e-5])
def test_readings_beside_a_magnet_are_kept_however_coarse_and_held(digit):
    away = np.abs(np.arange(400) - 200)[:, None]
    field = [2e-5, 0.0, -4.5e-5] + 4e-3 / (1 + (away / 9) ** 3) * [0.3, -0.5, 0.8]
    walk = Survey(
        np.arange(400)[:, None] * [0.02, 0.0, 0.0], np.repeat(np.round(field[::2] / digit) * digit, 2, axis=0)
    )
    assert len(walk) - len(without_missing(walk)) <= 4


def test_channels_follow_the_samples_that_marks_leave(room, tmp_path):
    path = tmp_path / "marked.csv"
    replace(room, times=None, orientations=None).save(path)
    rows = path.read_text().splitlines()
    rows = [f"{row},{k if k else 'current'}" for k, row in enumerate(rows)]
    cells = rows[5].split(",")
    rows[5] = ",".join([*cells[:3], "0", "0", "0", *cells[6:]])
    path.write_text("\n".join(rows))
    survey, channels = read_survey_and_channels(path)
    assert len(survey) == 49
    np.testing.assert_array_equal(channels["current"], np.delete(np.arange(1, 51), 4))


def test_half_of_a_log_may_be_filled_with_zeros(room):
    filled = replace(room, field=room.field * (np.arange(len(room)) % 2)[:, None])
    assert len(without_missing(filled)) == 25
    dead = replace(room, field=0 * room.field)
    assert without_missing(dead) is dead


def test_absurd_readings_are_left_to_the_checks(room):
    absurd = changed(changed(room, "field", (3, 0), 1e300), "field", (7, 2), -1e200)
    assert without_missing(absurd) is absurd
    with pytest.raises(SurveyError, match="sample 3"):
        check_survey(absurd)


def test_samples_listed_to_and_fro_are_not_two_sensors(room):
    column = np.tile([0.0, 0.5], 25)
    station = np.repeat(np.arange(25), 2)
    points = np.column_stack([0.3 * station, np.sin(station), column])
    listed = replace(room, positions=points, orientations=None, field=room.field + 1e-5 * column[:, None])
    assert not [said for said in check_survey(listed) if "to and fro" in said]


def test_a_jump_of_the_odometry_is_said_and_a_gap_is_none():
    angle = np.linspace(0, 6, 600)
    path = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    walk = Survey(path, 3e-5 + 1e-6 * path, times=0.02 * np.arange(600))
    after = (np.arange(600) >= 300)[:, None]
    jumped = replace(walk, positions=path + 4.0 * after * [1, 0, 0])
    assert [w for w in check_survey(jumped) if "jumps by 4 m at 5.98 s: odometry that lost itself" in w]
    paused = replace(jumped, times=walk.times + 60 * after[:, 0])
    assert not [w for w in [*check_survey(walk), *check_survey(paused)] if "jump" in w]


def walked(n=1000, digit=0.0, seed=0):
    """A walk round a room whose field varies over a metre, by a sensor with noise and maybe coarse digits."""
    angle = np.linspace(0, 4 * np.pi, n)
    path = np.column_stack([4 * np.cos(angle), 3 * np.sin(angle), 0.1 * np.sin(3 * angle)])
    field = np.array([2e-5, 0.0, -4e-5]) + 4e-6 * np.sin(path @ [[1.0, 2.0, 0.5], [2.0, 1.0, 1.5], [0, 1.0, 2.0]])
    field += np.random.default_rng(seed).normal(0, 1e-7, (n, 3))
    return Survey(path, np.round(field / digit) * digit if digit else field, times=0.02 * np.arange(n))


def stuck(survey, first, last):
    """The survey with one reading held from a sample to another."""
    held = np.arange(len(survey))
    held[first : last + 1] = first
    return replace(survey, field=survey.field[held])


@pytest.mark.parametrize("digit", [0.0, 2e-7])
def test_a_sensor_that_hangs_while_it_moves_is_said(digit):
    (said,) = check_survey(stuck(walked(digit=digit), 400, 440))
    assert "the field reads the same from 8 s to 8.8 s, over 1.8" in said
    (said,) = check_survey(stuck(replace(walked(), times=None), 400, 440))
    assert "from sample 400 to sample 440" in said


@pytest.mark.parametrize("digit", [0.0, 1e-7, 1e-6, 5e-6, 2e-5])
def test_coarse_digits_and_standing_still_are_no_sensor_that_hangs(digit):
    survey = walked(3000, digit)
    paused = survey.subset(np.repeat(np.arange(3000), 1 + 99 * (np.arange(3000) == 1500)))
    paused = replace(paused, times=0.02 * np.arange(len(paused)))
    held = replace(survey, field=np.repeat(survey.field[::25], 25, axis=0))
    for one in (survey, paused, held):
        assert not [said for said in check_survey(one) if "hang" in said]


def test_odometry_that_restarts_is_said():
    survey = walked()
    after = np.arange(1000) >= 600
    shift = survey.positions[0] - survey.positions[600]
    positions = survey.positions + after[:, None] * shift
    positions[600] = positions[0]
    restarted = replace(survey, positions=positions, times=survey.times + 3.0 * after)
    said = [words for words in check_survey(restarted) if "position" in words]
    assert len(said) == 1
    assert "jumps to exactly the first one at 15 s: was odometry restarted there?" in said[0]
    lap = replace(survey, positions=np.vstack([survey.positions[:-1], survey.positions[:1]]))
    assert check_survey(lap) == []


def test_a_sensor_that_always_reads_the_same_is_said(room):
    warnings = check_survey(replace(room, field=room.orientations.apply([2e-5, 0.0, 4e-5])))
    assert any("constant in the sensor's axes (varies less than 1 nT): nothing tells" in one for one in warnings)
    # Undone, the turns leave no scatter, which is no number to be told.
    assert all(len(number) < 6 for one in warnings for number in re.findall(r"\d+", one)), warnings


def test_warnings_reach_the_log_with_the_file_name(room, tmp_path, caplog):
    path = tmp_path / "flat.csv"
    replace(room, positions=room.positions * [1.0, 1.0, 0.0]).save(path)
    with caplog.at_level(logging.WARNING, logger="magmatch"):
        read_survey(path)
    assert f"{path}: all samples lie on one plane" in caplog.text


@pytest.mark.parametrize("unit", TESLA_PER_UNIT)
@settings(deadline=None, max_examples=20)
@given(field=st.floats(22e-6, 67e-6))
def test_the_unit_of_any_place_on_earth_is_recognised(unit, field):
    assert likely_field_unit(field / TESLA_PER_UNIT[unit]) == unit


def test_description_holds_counts_extent_time_and_doubts(room):
    gapped = replace(room, times=room.times + 60 * (room.times > 10), pose_sd=0.02)
    about = describe(gapped)
    assert (about["samples"], about["pose_sd"], about["orientations"]) == (50, 0.02, True)
    np.testing.assert_allclose(about["extent"], np.ptp(room.positions, axis=0))
    np.testing.assert_allclose(about["field"]["mean"], room.field.mean(axis=0))
    assert [about["time"][name] for name in ("gaps", "longest_gap", "rate")] == pytest.approx([1, 60.5, 2.0])
    assert about["warnings"] == check_survey(gapped)
