# SPDX-License-Identifier: BSD-3-Clause
"""Messages may be stored in any order: what counts is when they were logged, and what their stamps say against it."""

import numpy as np
import pytest
import yaml

from magmatch.data.logs.drift import read_drift
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError

SECOND = 1_000_000_000
ORDERS = {
    "the second half first": lambda n: np.roll(np.arange(n), n // 2),
    "three pieces": lambda n: np.concatenate([np.arange(n)[k::3] for k in (0, 2, 1)]),
    "the middle last": lambda n: np.argsort(np.abs(np.arange(n) - n // 2) < n // 5, kind="stable"),
    "the last first": lambda n: np.arange(n)[::-1],
    "none at all": lambda n: np.random.default_rng(1).permutation(n),
}
CONTAINERS = ["ROS 1 bag", "ROS 2 bag, sqlite3", "ROS 2 bag, mcap", "MCAP without chunks", "MCAP without summary"]


@pytest.fixture
def stored(made, monkeypatch):
    """Have the writers store messages in another order than that of time."""
    plain = made.mcap.__globals__["in_time"]

    def store(order):
        def permuted(series, messages):
            rows = list(plain(series, messages))
            return [rows[i] for i in order(len(rows)).tolist()]

        monkeypatch.setitem(made.mcap.__globals__, "in_time", permuted)

    return store


@pytest.mark.parametrize(
    ("container", "order"),
    [
        (c, o)
        for c in CONTAINERS
        for o in ORDERS
        if c == CONTAINERS[-1] or o in ("the second half first", "none at all")
    ],
)
def test_the_order_of_storage_changes_nothing_and_is_no_news(
    container, order, made, flight, stored, tmp_path, caplog
):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    expected = read_survey(made.WRITERS[container](tmp_path / "a", flight.series))
    stored(ORDERS[order])
    survey = read_survey(made.WRITERS[container](tmp_path / "b", flight.series))
    for name in ("times", "positions", "field"):
        np.testing.assert_array_equal(getattr(survey, name), getattr(expected, name))
    assert "out of order" not in caplog.text


@pytest.mark.parametrize("order", ORDERS)
def test_a_stamp_set_back_is_found_in_any_order_of_storage(order, made, flight, stored, tmp_path):
    mag, odom = flight.series
    stamps = odom.stamp_ns.copy()
    stamps[70:] -= 3 * SECOND
    stored(ORDERS[order])
    with pytest.raises(DataFormatError, match="time runs backward"):
        read_survey(made.mcap(tmp_path / "log.mcap", [mag, made.replace(odom, stamp_ns=stamps)]))


@pytest.mark.parametrize("step", [0.5, 0.525])
def test_a_clock_set_back_by_less_is_said(step, made, flight, tmp_path, caplog):
    """Readings that came late, or in batches, are no such step."""
    mag, odom = flight.series
    path, n = tmp_path / "log.mcap", np.arange(len(odom.log_ns))
    read_survey(
        made.mcap(path, [mag, made.replace(odom, stamp_ns=np.where(n < 70, 0, -int(step * SECOND)) + odom.stamp_ns)])
    )
    assert f"time on /odom runs backward by {step - 0.05:.3g} s at {odom.stamp_ns[69] / SECOND:.3f} s" in caplog.text
    assert "out of order" not in caplog.text
    caplog.clear()
    for order in (np.r_[:60, 61, 60, 62:130], np.r_[:60, 70, 60:70, 71:130], np.r_[:60, 70:80, 60:70, 80:130]):
        late = made.replace(odom, stamp_ns=odom.stamp_ns[order], values=odom.values[order])
        read_survey(made.mcap(path, [mag, late]))
    assert "runs backward" not in caplog.text
    assert caplog.text.count("out of order") == 3


def test_a_recorders_clock_set_back_is_refused_too(made, flight, tmp_path, monkeypatch):
    """Log times and stamps go back together: messages from before and after would lie in turns."""
    series = []
    for one in flight.series:
        log_ns = one.log_ns.copy()
        log_ns[one.log_ns > one.log_ns[0] + 4 * SECOND] -= 2 * SECOND
        series.append(made.replace(one, log_ns=log_ns, stamp_ns=None))

    def as_written(series, messages):
        rows = [
            (s.log_ns[0] + i * (s.log_ns[1] - s.log_ns[0]), k, i)
            for k, s in enumerate(series)
            for i in range(len(s.log_ns))
        ]
        for _, k, i in sorted(rows):
            yield k, int(series[k].log_ns[i]), bytes(messages.serialise(messages.build(series[k], i), series[k].type))

    monkeypatch.setitem(made.mcap.__globals__, "in_time", as_written)
    with pytest.raises(DataFormatError, match=r"time runs backward by 1\.98 s; a clock that was set anew"):
        read_survey(made.mcap(tmp_path / "log.mcap", series))


@pytest.mark.parametrize("is_listed", [True, False])
def test_files_of_a_split_bag_may_be_listed_by_name(is_listed, made, flight, tmp_path):
    """``walk_10`` stands before ``walk_2``."""
    mag, odom = flight.series
    expected = read_survey(made.ros2(tmp_path / "whole", [mag, odom]))
    folder, names = tmp_path / "walk", []
    for k, number in enumerate((0, 2, 10)):
        part = [
            made.replace(s, log_ns=s.log_ns[rows], stamp_ns=None, values=s.values[rows])
            for s in (mag, odom)
            for rows in [slice(k * len(s.log_ns) // 3, (k + 1) * len(s.log_ns) // 3)]
        ]
        piece = made.ros2(folder if k == 0 else tmp_path / f"walk{k}", part)
        (file,) = piece.glob("*.db3")
        file.rename(folder / f"walk_{number}.db3")
        names.append(f"walk_{number}.db3")
    about = yaml.safe_load((folder / "metadata.yaml").read_text())
    about["rosbag2_bagfile_information"]["relative_file_paths"] = sorted(names)
    (folder / "metadata.yaml").write_text(yaml.safe_dump(about))
    if not is_listed:
        (folder / "metadata.yaml").unlink()
    survey = read_survey(folder)
    np.testing.assert_array_equal(survey.times, expected.times)
    np.testing.assert_array_equal(survey.field, expected.field)


def test_the_last_static_transform_is_the_one_logged_last(made, flight, stored, tmp_path):
    mag, odom = flight.series
    log = [mag, made.replace(odom, child="base")]
    lever = np.array([[0.0, 0, 1, 0, 0, 0, 1], [0.0, 0, 2, 0, 0, 0, 1]])
    static = made.Series(
        "/tf_static", "tf2_msgs/msg/TFMessage", odom.log_ns[:2], lever, frame="base", child="mag_link"
    )
    expected = read_survey(made.mcap(tmp_path / "log.mcap", [*log, static]))
    stored(lambda n: np.arange(n)[::-1])
    survey = read_survey(made.mcap(tmp_path / "other.mcap", [*log, static]))
    np.testing.assert_array_equal(survey.positions, expected.positions)


def test_drift_is_that_of_the_path_in_time(made, flight, stored, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("magmatch.data.logs.drift.drift", lambda *what: seen.append(what))
    read_drift(made.mcap(tmp_path / "log.mcap", flight.series))
    stored(ORDERS["none at all"])
    read_drift(made.mcap(tmp_path / "other.mcap", flight.series))
    np.testing.assert_array_equal(seen[0][0], seen[1][0])
