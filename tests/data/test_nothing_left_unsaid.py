# SPDX-License-Identifier: BSD-3-Clause
"""Times in an index or in a column without our name are taken, or what is left out is said."""

import logging

import numpy as np
import pytest

from magmatch.data.read import read_survey
from magmatch.data.survey import Survey

N = 20


@pytest.fixture
def pd():
    return pytest.importorskip("pandas")


@pytest.fixture
def frame(pd, rng):
    columns = {name: rng.uniform(0, 2, N) for name in "xyz"}
    return pd.DataFrame(columns | {name: rng.normal(2e-5, 1e-6, N) for name in ("bx", "by", "bz")})


@pytest.fixture
def dates(pd):
    return pd.to_datetime(1_700_000_000_123_456_789 + 20_000_000 * np.arange(N))


SECONDS = [(1_700_000_000_123_456_789 + 20_000_000 * i) / 10**9 for i in range(N)]


@pytest.mark.parametrize("name", [None, "timestamp"])
def test_an_index_of_dates_is_the_time(name, frame, dates):
    survey = Survey.from_dataframe(frame.set_index(dates.rename(name)))
    np.testing.assert_array_equal(survey.times, SECONDS)


def test_a_level_of_dates_is_the_time(pd, frame, dates):
    frame.index = pd.MultiIndex.from_arrays([["walk"] * N, dates])
    np.testing.assert_array_equal(Survey.from_dataframe(frame).times, SECONDS)


def test_parquet_of_an_index_of_dates_has_times(frame, dates, tmp_path):
    pytest.importorskip("pyarrow")
    frame.set_index(dates).to_parquet(tmp_path / "s.parquet")
    np.testing.assert_array_equal(read_survey(tmp_path / "s.parquet").times, SECONDS)


INDEXES = {
    "seconds": lambda pd: pd.Index(np.arange(N) / 50),
    "dates that repeat": lambda pd: pd.to_datetime(["2026-11-28"] * N),
    "texts": lambda pd: pd.Index([f"2026-11-28T10:00:{i:02d}" for i in range(N)]),
    "stamps": lambda _: 1_700_000_000_000_000_000 + np.arange(N),
    "differences": lambda pd: pd.to_timedelta(np.arange(N), "s"),
}


@pytest.mark.parametrize("case", INDEXES)
def test_another_index_is_said_to_be_left_out(case, pd, frame, caplog):
    with caplog.at_level(logging.WARNING):
        survey = Survey.from_dataframe(frame.set_index(INDEXES[case](pd)))
    assert survey.times is None
    assert "index without a name is left out; if it holds the times, name it t" in caplog.text


def test_row_numbers_are_nothing_to_speak_of(frame, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        Survey.from_dataframe(frame[frame.x > 0.5])
        frame.to_csv(tmp_path / "s.csv")
        read_survey(tmp_path / "s.csv")
    assert "left out" not in caplog.text


@pytest.mark.parametrize(
    "first", [lambda i: f"{i / 50:.2f}", lambda i: f"2026-11-28 10:00:{i:02d}", lambda i: 20 * i]
)
def test_a_column_without_a_name_is_said_to_be_left_out(first, frame, tmp_path, caplog):
    frame.index = [first(i) for i in range(N)]
    frame.to_csv(tmp_path / "s.csv")
    with caplog.at_level(logging.WARNING):
        assert read_survey(tmp_path / "s.csv").times is None
    assert "a column without a name is left out; if it holds times, name it t in the header" in caplog.text


@pytest.mark.parametrize("name", ["timestamp", "Time", "time_s", "header.stamp"])
def test_a_column_of_times_with_another_name_is_said_to_be_left_out(name, frame, tmp_path, caplog):
    pytest.importorskip("pyarrow")
    frame = frame.assign(**{name: np.arange(N) / 50})
    frame.to_csv(tmp_path / "s.csv", index=False)
    frame.to_parquet(tmp_path / "s.parquet")
    for read in (
        lambda: read_survey(tmp_path / "s.csv"),
        lambda: read_survey(tmp_path / "s.parquet"),
        lambda: Survey.from_dataframe(frame),
    ):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            assert read().times is None
        assert f"'{name.lower()}' is left out; if it holds the times: --columns t=" in caplog.text.lower()


def test_an_index_of_stamps_in_parquet_is_said(frame, tmp_path, caplog):
    pytest.importorskip("pyarrow")
    frame.set_index(1_700_000_000_000_000_000 + np.arange(N) ** 2).to_parquet(tmp_path / "s.parquet")
    assert read_survey(tmp_path / "s.parquet").times is None
    assert "its index without a name is left out" in caplog.text


def test_times_of_a_matlab_file_that_are_no_numbers_are_said(frame, tmp_path, caplog):
    from scipy.io import savemat

    arrays = {name: frame[name].to_numpy() for name in frame}
    savemat(tmp_path / "s.mat", arrays | {"t": np.array([f"10:00:{k:02d}" for k in range(N)])})
    assert read_survey(tmp_path / "s.mat").times is None
    assert "its 't' holds no column of real numbers and is left out" in caplog.text
