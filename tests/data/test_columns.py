# SPDX-License-Identifier: BSD-3-Clause
"""Which columns of a table are which: by name, by number, one constant; dates; places on the globe."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from magmatch.data.formats.csv import read_points
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.geodesy import Origin, local_east_north, local_east_north_up
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import origin_of
from magmatch.errors import ConfigurationError, DataFormatError, SurveyError
from magmatch.field.build import surveys_of

N = 12
T = 0.1 * np.arange(N)
XYZ = np.random.default_rng(0).uniform(0, 3, (N, 3)).round(3)
FIELD = np.random.default_rng(1).normal([20, 3, -45], 1, (N, 3)).round(3)
ROWS = np.column_stack([T, XYZ, FIELD])
NAMED = "t=1,x=2,y=3,z=4,bx=5,by=6,bz=7"


def write(path, header, rows, mark=","):
    lines = [mark.join(cell if isinstance(cell, str) else repr(float(cell)) for cell in row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines, ""]))
    return path


def read(path, columns=None, **options):
    return read_survey(path, SurveyFormat(columns=columns, field_unit="uT", **options))


# Stated names


@pytest.fixture(params=["csv", "parquet", "DataFrame"])
def door(request, tmp_path):
    """Reads a table of columns {name: values} by what is stated."""
    pd = pytest.importorskip("pandas")

    def read_it(columns, stated):
        frame = pd.DataFrame(columns)
        pairs = ",".join(f"{ours}={theirs}" for ours, theirs in stated.items())
        if request.param == "DataFrame":
            return Survey.from_dataframe(frame, "uT", columns=stated)
        path = tmp_path / f"walk.{request.param}"
        if request.param == "csv":
            frame.to_csv(path, index=False)
        else:
            pytest.importorskip("pyarrow")
            frame.to_parquet(path, compression="zstd")
        return read(path, pairs or None)

    return read_it


def test_a_stated_name_is_read_where_it_is_one_of_our_own_for_something_else(door):
    own = dict(zip(["X", "Y", "Z"], FIELD.T, strict=True)) | dict(zip("abc", XYZ.T, strict=True))
    survey = door(own, {"bx": "X", "by": "Y", "bz": "Z", "x": "a", "y": "b", "z": "c"})
    np.testing.assert_array_equal(survey.field, FIELD * 1e-6)
    np.testing.assert_array_equal(survey.positions, XYZ)


def test_a_column_that_is_stated_for_one_thing_is_not_guessed_for_another(door):
    own = dict(zip(["x", "y", "z"], FIELD.T, strict=True))
    with pytest.raises(DataFormatError, match="missing x, y, z"):
        door(own, {"bx": "x", "by": "y", "bz": "z"})


def test_one_column_cannot_be_two_things(door):
    own = dict(zip(["x", "y", "z", "bx", "by", "bz"], np.hstack([XYZ, FIELD]).T, strict=True))
    with pytest.raises(ConfigurationError, match="a column of its own for y, found 'x' for x too"):
        door(own, {"x": "x", "y": "x"})


@pytest.mark.parametrize("text", ["", "x", "x=", "x=a,x", "q=a", "x=a,x=b", "=a"])
def test_columns_that_are_no_pairs_are_refused(text, tmp_path):
    with pytest.raises(ConfigurationError, match="--columns: expected pairs"):
        read(write(tmp_path / "s.csv", "x,y,z,bx,by,bz", ROWS[:, 1:]), text)


def test_float32_and_integers_are_numbers_too(door):
    own = dict(zip(["x", "y", "bx", "by", "bz"], np.hstack([XYZ[:, :2], FIELD]).T, strict=True))
    halves = np.round(2 * FIELD[:, 0]) / 2  # which both precisions hold
    survey = door(own | {"bx": halves.astype(np.float32), "z": np.arange(N)}, {})
    np.testing.assert_array_equal(survey.field[:, 0], halves * 1e-6)
    np.testing.assert_array_equal(survey.positions[:, 2], np.arange(N))


# Numbers and constants


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_columns_of_a_table_without_header_are_stated_by_number(mark, tmp_path):
    survey = read(write(tmp_path / "s.txt", "", ROWS, mark), NAMED)
    np.testing.assert_array_equal(survey.positions, XYZ)
    np.testing.assert_array_equal(survey.field, FIELD * 1e-6)
    np.testing.assert_array_equal(survey.times, T)


@pytest.mark.parametrize("header", ["stamp,east,north,up,u,v,w", "0,1,2,3,4,5,6", "1,2,3,4,5,6,7"])
def test_numbers_count_columns_below_a_header_too(header, tmp_path):
    stated = NAMED if header[0] != "0" else "t=0,x=1,y=2,z=3,bx=4,by=5,bz=6"  # there a number is a name
    np.testing.assert_array_equal(read(write(tmp_path / "s.csv", header, ROWS), stated).positions, XYZ)


def test_other_columns_without_header_stay_beside_the_samples(tmp_path):
    path = write(tmp_path / "s.csv", "", np.column_stack([ROWS, np.arange(N)]))
    _, channels = read_survey_and_channels(path, SurveyFormat(columns=NAMED, field_unit="uT"))
    np.testing.assert_array_equal(channels["8"], np.arange(N))


@pytest.mark.parametrize("first", ["0.0", "2026-05-01T10:00:00Z"])
def test_a_table_without_header_says_how_to_state_numbers(first, tmp_path):
    path = write(tmp_path / "s.csv", "", [[first, *row[1:]] for row in ROWS.tolist()])
    with pytest.raises(DataFormatError, match=r"found numbers.*--columns t=1,x=2,y=3,z=4,bx=5,by=6,bz=7"):
        read(path)


def test_a_number_beyond_the_columns_is_refused(tmp_path):
    with pytest.raises(DataFormatError, match="expected a column '9' for bz"):
        read(write(tmp_path / "s.csv", "", ROWS), NAMED.replace("bz=7", "bz=9"))


@pytest.mark.parametrize(
    ("text", "z"), [("0", 0), ("1.20", 1.2), ("-3", -3), ("\u22121.5", -1.5), ("+2", 2), ("1e0", 1)]
)
def test_a_constant_stands_for_a_column(door, text, z):
    own = dict(zip(["x", "y", "bx", "by", "bz"], np.hstack([XYZ[:, :2], FIELD]).T, strict=True))
    np.testing.assert_array_equal(door(own, {"z": text}).positions[:, 2], z)
    with pytest.raises(DataFormatError, match="missing z"):
        door(own, {})


@pytest.mark.parametrize("first", ["t", "Time [s]", "id", "", "latitude"])
def test_a_whole_number_is_no_column_of_something_else(first, tmp_path):
    path = write(tmp_path / "s.csv", f"{first},x,y,bx,by,bz", np.delete(ROWS, 3, axis=1))
    with pytest.raises(DataFormatError, match=r"found that column 1 is '.*'; a constant of 1 is z=1\.0"):
        read(path, "z=1")
    np.testing.assert_array_equal(read(path, "z=1.0").positions[:, 2], 1.0)
    np.testing.assert_array_equal(read(path, "z=2,x=3,y=2.0").positions[:, 2], XYZ[:, 0])


def test_a_number_that_counts_no_column_may_be_a_constant(door):
    own = dict(zip(["x", "y", "bx", "by", "bz"], np.hstack([XYZ[:, :2], FIELD]).T, strict=True))
    with pytest.raises(DataFormatError, match=r"expected a column '9' for z, .*; a constant of 9 is z=9\.0"):
        door(own, {"z": "9"})


@pytest.mark.parametrize("pair", ["bz=0", "t=0.5"])
def test_what_is_measured_is_no_constant(pair, tmp_path):
    path = write(tmp_path / "s.csv", "x,y,z,bx,by", np.hstack([XYZ, FIELD[:, :2]]))
    with pytest.raises(ConfigurationError, match="expected a column for"):
        read(path, pair)


def test_a_column_so_named_stands_before_a_constant(tmp_path):
    path = write(tmp_path / "s.csv", "x,y,0,bx,by,bz", np.hstack([XYZ, FIELD]))
    np.testing.assert_array_equal(read(path, "z=0").positions, XYZ)


# Times


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2026-05-01T10:00:{:06.3f}", 1777629600),
        ("2026-05-01 10:00:{:06.3f}Z", 1777629600),
        ("2026-05-01T12:00:{:06.3f}+02:00", 1777629600),
        ("20260501T1000{:012.9f}Z", 1777629600),
        ('"2026-05-01 05:30:{:012.9f}-0430"', 1777629600),
    ],
)
def test_dates_become_seconds_since_1970(text, seconds, tmp_path):
    rows = [[text.format(t), *row] for t, row in zip(T, ROWS[:, 1:].tolist(), strict=True)]
    survey = read(write(tmp_path / "s.csv", "t,x,y,z,bx,by,bz", rows))
    np.testing.assert_allclose(survey.times, seconds + T, rtol=0, atol=3e-7)


def test_dates_keep_their_nanoseconds_until_they_are_rounded_once(tmp_path):
    rows = [[f"2023-11-14T22:13:20.{123456789 + 1000 * i}Z", *ROWS[i, 1:]] for i in range(N)]
    times = read(write(tmp_path / "s.csv", "t,x,y,z,bx,by,bz", rows)).times
    assert times.tolist() == [(1_700_000_000_123_456_789 + 1000 * i) / 10**9 for i in range(N)]


def test_a_rate_gives_samples_their_times(tmp_path, caplog):
    path = write(tmp_path / "s.csv", "x,y,z,bx,by,bz", ROWS[:, 1:])
    assert read(path, rate=50.0).times.tolist() == (np.arange(N) / 50).tolist()
    stamped = write(tmp_path / "t.csv", "t,x,y,z,bx,by,bz", ROWS * [0, 1, 1, 1, 1, 1, 1])
    assert read(stamped, rate=50.0).times.tolist() == (np.arange(N) / 50).tolist()
    assert "column t is ignored" in caplog.text
    with pytest.raises(ConfigurationError, match="leave one of them out"):
        read(stamped, "t=t", rate=50.0)


def test_rows_that_are_left_out_took_their_time(tmp_path):
    rows = [[*row[:4], "nan", *row[5:]] if i == 3 else row for i, row in enumerate(ROWS[:, 1:].tolist())]
    rows = [list(map(str, row)) for row in rows]
    survey = read(write(tmp_path / "s.csv", "x,y,z,bx,by,bz", rows), rate=10.0, recover=True)
    np.testing.assert_allclose(survey.times, np.delete(np.arange(N), 3) / 10)


# Places on the globe

LAT, LON, ALT = 48.1 + 1e-5 * XYZ[:, 0], 11.5 + 1e-5 * XYZ[:, 1], 500 + XYZ[:, 2]
GLOBE = np.column_stack([LAT, LON, ALT, FIELD])
ORIGIN = Origin(48.1, 11.5, 500.0)


@pytest.mark.parametrize(
    "names", ["lat,lon,alt", "Latitude,Longitude,Altitude", "latitude_deg,longitude_deg,elevation", "LAT,LNG,height"]
)
def test_degrees_become_metres_east_north_and_up_of_the_origin(names, tmp_path):
    survey = read(write(tmp_path / "s.csv", f"{names},bx,by,bz", GLOBE), origin="48.1,11.5,500")
    np.testing.assert_array_equal(survey.positions, local_east_north_up(LAT, LON, ALT, ORIGIN))
    assert survey.frame == "east, north, up of 48.1,11.5,500.0"


def test_degrees_are_read_through_every_door(door):
    own = dict(zip(["lat", "lon", "alt", "bx", "by", "bz"], GLOBE.T, strict=True))
    survey = door(own, {})
    np.testing.assert_allclose(pdist(survey.positions), pdist(local_east_north_up(LAT, LON, ALT, ORIGIN)), atol=1e-6)
    named = dict(zip(["u", "v", "w", "bx", "by", "bz"], GLOBE.T, strict=True))
    again = door(named, {"lat": "u", "lon": "v", "alt": "w"})
    np.testing.assert_array_equal(again.positions, survey.positions)


def test_the_origin_is_said_and_gives_the_same_frame_when_stated(tmp_path, caplog):
    path = write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE)
    survey = read(path)
    origin = caplog.text.partition("--origin ")[2].split()[0]
    again = read(path, origin=origin)
    np.testing.assert_array_equal(again.positions, survey.positions)
    assert again.frame == survey.frame
    assert float(np.abs(survey.positions[0]).max()) < 1  # the origin is near the first sample
    survey.save(tmp_path / "o.csv")
    assert read_survey(tmp_path / "o.csv").frame == survey.frame


def test_height_may_come_from_z_or_a_constant(tmp_path):
    path = write(tmp_path / "s.csv", "lat,lon,bx,by,bz", np.delete(GLOBE, 2, axis=1))
    flat = read(path, "z=0", origin="48.1,11.5")
    np.testing.assert_array_equal(flat.positions[:, :2], local_east_north(LAT, LON, Origin(48.1, 11.5)))
    np.testing.assert_array_equal(flat.positions[:, 2], 0)
    with pytest.raises(DataFormatError, match=r"missing alt.*--columns z=0"):
        read(path)


def test_metres_stand_before_degrees_unless_degrees_are_stated(tmp_path):
    rows = np.column_stack([XYZ, GLOBE])
    path = write(tmp_path / "s.csv", "x,y,z,lat,lon,alt,bx,by,bz", rows)
    np.testing.assert_array_equal(read(path).positions, XYZ)
    stated = read(path, "lat=lat,lon=lon,alt=alt", origin="48.1,11.5,500")
    np.testing.assert_array_equal(stated.positions, local_east_north_up(LAT, LON, ALT, ORIGIN))


def test_degrees_without_a_fix_are_no_matter_where_positions_are_in_metres(tmp_path):
    rows = [[*map(str, row), "", ""] for row in ROWS[:, 1:].tolist()]
    path = write(tmp_path / "s.csv", "x,y,z,bx,by,bz,lat,lon", rows)
    np.testing.assert_array_equal(read(path).positions, XYZ)


def test_numbers_that_are_no_degrees_are_refused(tmp_path):
    path = write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE * [1e7, 1e7, 1, 1, 1, 1])
    with pytest.raises(DataFormatError, match="found a latitude of 4"):
        read(path)


def test_radians_are_told_and_degrees_are_not(tmp_path, caplog):
    read(write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE))
    assert "at sea" not in caplog.text
    read(write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", np.column_stack([np.radians(GLOBE[:, :2]), GLOBE[:, 2:]])))
    assert "found places at sea, such as 0.8395" in caplog.text


@pytest.mark.parametrize("origin", ["48.1", "here", "48.1,11.5,0,0", "95,11", "48.1,nan"])
def test_what_is_no_origin_is_refused(origin, tmp_path):
    with pytest.raises(ConfigurationError, match="origin: expected"):
        read(write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE), origin=origin)


def test_points_on_the_globe_are_read_about_the_origin_of_a_map(tmp_path):
    frame = read(write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE), origin="48.1,11.5,500").frame
    path = write(tmp_path / "p.csv", "Latitude,Longitude,Altitude", GLOBE[:, :3])
    points = read_points(path, SurveyFormat(origin=origin_of(frame)))
    np.testing.assert_array_equal(points, local_east_north_up(LAT, LON, ALT, ORIGIN))
    with pytest.raises(DataFormatError, match="expected columns such as x, y, z; found latitude"):
        read_points(path, SurveyFormat(origin=origin_of("survey")))


def test_surveys_about_two_origins_make_no_map(tmp_path):
    path = write(tmp_path / "s.csv", "lat,lon,alt,bx,by,bz", GLOBE)
    here, there = read(path, origin="48.1,11.5,500"), read(path, origin="48.2,11.5,500")
    assert len(surveys_of([here, here])) == 2
    with pytest.raises(SurveyError, match=r"one frame.*--origin 48.1,11.5,500.0"):
        surveys_of([here, there])


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_channels_beside_dates_are_read_at_the_times_of_the_samples(suffix, tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    dates = pd.to_datetime(1_700_000_000 + np.arange(N), unit="s")
    own = {"t": dates} | dict(zip(["x", "y", "z", "bx", "by", "bz"], ROWS[:, 1:].T, strict=True))
    frame, path = pd.DataFrame(own | {"motor": np.arange(N) * 1.5}), tmp_path / f"s.{suffix}"
    if suffix == "csv":
        frame.to_csv(path, index=False)
    else:
        frame.to_parquet(path)
    survey, channels = read_survey_and_channels(path, SurveyFormat(field_unit="uT", time_unit="ms"))
    np.testing.assert_array_equal(survey.times, 1_700_000_000 + np.arange(N))
    np.testing.assert_array_equal(channels["motor"], np.arange(N) * 1.5)
