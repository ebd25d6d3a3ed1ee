# SPDX-License-Identifier: BSD-3-Clause
"""The same whole nanoseconds are the same float64 seconds, whatever table they stand in."""

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.data.survey import Survey

N = 200
RNG = np.random.default_rng(5)
STAMPS = 1_700_000_000_005_070_124 + np.cumsum(RNG.integers(4_000_000, 6_000_000, N))
SECONDS = [stamp / 10**9 for stamp in STAMPS.tolist()]
POSITIONS, FIELD = RNG.uniform(0, 3, (N, 3)).round(3), RNG.normal(30, 3, (N, 3)).round(3)
UT = {"field_unit": "uT"}


def columns():
    return dict(zip(("x", "y", "z", "bx", "by", "bz"), np.column_stack([POSITIONS, FIELD]).T, strict=True))


def text(times, names="t,x,y,z,bx,by,bz", mark=","):
    rows = np.column_stack([POSITIONS, FIELD]).tolist()
    lines = [mark.join([str(t), *map(repr, row)]) for t, row in zip(times, rows, strict=True)]
    return "\n".join([names.replace(",", mark), *lines, ""])


def decimals(digits):
    """The stamps in a larger unit, to the last nanosecond."""
    return [f"{stamp // 10**digits}.{stamp % 10**digits:0{digits}d}" for stamp in STAMPS.tolist()]


WAYS = {
    "ns": (STAMPS.tolist(), "ns", lambda line: line),
    "us": (decimals(3), "us", lambda line: line),
    "ms": (decimals(6), "ms", lambda line: line),
    "s": (decimals(9), "s", lambda line: line),
    "ns, cell by cell": (STAMPS.tolist(), "ns", lambda line: line + ","),
    "ms with decimal commas": (decimals(6), "ms", lambda line: line.replace(",", ";").replace(".", ",")),
    "ns of white space": (STAMPS.tolist(), "ns", lambda line: line.replace(",", " ")),
    "ns with an exponent": ([f"{s}e0" for s in STAMPS.tolist()], "ns", lambda line: line),
}


@pytest.mark.parametrize("way", WAYS)
def test_times_in_text_are_rounded_once(way, tmp_path):
    times, unit, change = WAYS[way]
    path = tmp_path / "s.csv"
    path.write_text("\n".join(map(change, text(times).split("\n"))))
    np.testing.assert_array_equal(read_survey(path, SurveyFormat(time_unit=unit, **UT)).times, SECONDS)


def test_parquet_of_whole_numbers_and_of_stamps(tmp_path):
    pq, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    for k, times in enumerate(
        [pa.array(STAMPS), pa.array(STAMPS.astype(np.uint64)), pa.array(STAMPS, pa.timestamp("ns"))]
    ):
        pq.write_table(pa.table({"t": times, "motor": np.arange(N) / 2} | columns()), tmp_path / f"{k}.parquet")
        survey, channels = read_survey_and_channels(tmp_path / f"{k}.parquet", SurveyFormat(time_unit="ns", **UT))
        np.testing.assert_array_equal(survey.times, SECONDS)
        np.testing.assert_array_equal(channels["motor"], np.arange(N) / 2)


@pytest.mark.parametrize("kind", ["5", "7.3"])
def test_whole_numbers_of_matlab(kind, tmp_path):
    path = tmp_path / "s.mat"
    if kind == "5":
        pytest.importorskip("scipy.io").savemat(path, columns() | {"t": STAMPS})
    else:
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, values in (columns() | {"t": STAMPS}).items():
                file[name] = values
    np.testing.assert_array_equal(read_survey(path, SurveyFormat(time_unit="ns", **UT)).times, SECONDS)


@pytest.mark.parametrize("dtype", ["int64", "uint64", "Int64", "datetime64[ns]"])
def test_whole_numbers_and_dates_of_pandas(dtype):
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame(columns() | {"t": pd.Series(STAMPS).astype(dtype)})
    np.testing.assert_array_equal(Survey.from_dataframe(frame, "uT", time_unit="ns").times, SECONDS)


def test_euroc_and_trajectories_that_state_nanoseconds(tmp_path):
    rows = [f"{t},{i},0,0,1,0,0,0" for i, t in enumerate(STAMPS.tolist())]
    (tmp_path / "e.csv").write_text("\n".join(["#timestamp [ns],x,y,z,qw,qx,qy,qz", *rows]))
    (tmp_path / "t.tum").write_text("\n".join(["# t_ns x y z qw qx qy qz", *rows]).replace(",", " "))
    for name in ("e.csv", "t.tum"):
        np.testing.assert_array_equal(load_trajectory(tmp_path / name, SurveyFormat()).times, SECONDS)


PHONES = {
    "Sensor Logger": ("time,seconds_elapsed,z,y,x", "{},0,1,2,3"),
    "Android": ("event.timestamp,x,y,z", "{},1,2,3"),
    "Android, rows of several sensors": ("event.timestamp,sensor,x,y,z", "{},2,1,2,3"),
}


@pytest.mark.parametrize("app", PHONES)
def test_stamps_of_phones(app, tmp_path):
    header, row = PHONES[app]
    (tmp_path / "Magnetometer.csv").write_text("\n".join([header, *(row.format(t) for t in STAMPS.tolist())]))
    log = read_phone_log(tmp_path / "Magnetometer.csv")
    np.testing.assert_array_equal(log.streams["field"].times, SECONDS)


def test_a_sample_at_the_very_first_pose_is_kept(tmp_path, caplog):
    poses = [f"{t},{i / 100},0,0,1,0,0,0" for i, t in enumerate(STAMPS.tolist())]
    (tmp_path / "poses.csv").write_text("\n".join(["#timestamp [ns],x,y,z,qw,qx,qy,qz", *poses]))
    (tmp_path / "mag.csv").write_text(text(STAMPS.tolist()))
    layout = SurveyFormat(time_unit="ns", trajectory=tmp_path / "poses.csv", **UT)
    assert len(read_survey(tmp_path / "mag.csv", layout)) == N
    assert "dropped" not in caplog.text
