# SPDX-License-Identifier: BSD-3-Clause
"""Damaged logs: refused in one sentence that names the way out, and read up to the damage where that is asked for."""

import logging
import sqlite3

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.open import open_log
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError, MagmatchError

RECOVER = SurveyFormat(recover=True)
CHUNKED = {
    "ROS 1 bag": "log.bag",
    "ROS 1 bag, bz2": "log-bz2.bag",
    "ROS 1 bag, lz4": "log-lz4.bag",
    "MCAP of ROS 2": "log.mcap",
    "MCAP, lz4": "logl.mcap",
    "MCAP, not compressed": "logn.mcap",
    "MCAP without chunks": "logc.mcap",
    "MCAP without summary": "logs.mcap",
}


def messages_of(path, recover=False):
    """All messages that can be read: (topic, log time, payload)."""
    log = open_log(path, recover=recover)
    try:
        names = [topic.name for topic in log.topics()]
        found = [(channel.topic, t, payload) for channel, t, payload in log.messages(names)]
        return found, log.losses()
    finally:
        log.close()


@pytest.fixture(params=CHUNKED)
def whole(request, made, flight, tmp_path):
    """A log with small chunks, and all its messages."""
    path = made.WRITERS[request.param](tmp_path, flight.series)
    return path, set(messages_of(path)[0])


@pytest.mark.parametrize("share", [0.15, 0.4, 0.7, 0.95])
def test_what_stands_before_a_cut_is_read_and_nothing_else(share, whole, tmp_path):
    path, messages = whole
    raw = path.read_bytes()
    cut = tmp_path / ("cut" + path.suffix)
    cut.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(DataFormatError, match="--recover") as caught:
        messages_of(cut)
    assert "\n" not in str(caught.value)
    found, losses = messages_of(cut, recover=True)
    assert set(found) <= messages
    assert len(set(found)) == len(found)
    assert losses or share > 0.9  # there only the summary is lost
    assert len(found) > (share - 0.35) * len(messages)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_what_stands_behind_a_hole_is_read_too(share, whole, tmp_path):
    path, messages = whole
    raw = bytearray(path.read_bytes())
    start = int(share * len(raw))
    raw[start : start + 500] = bytes(range(250)) * 2
    holed = tmp_path / ("holed" + path.suffix)
    holed.write_bytes(raw)
    with pytest.raises(DataFormatError, match="--recover"):
        messages_of(holed)
    found, losses = messages_of(holed, recover=True)
    assert losses
    assert len(set(found) & messages) > 0.5 * len(messages)
    # Bags have no checksums: a message may come out changed where its chunk is stored as it is.
    if path.suffix == ".mcap" and path.name != "logc.mcap":
        assert set(found) <= messages


def test_recovered_samples_are_those_of_the_whole_log(whole, tmp_path, caplog):
    path, _ = whole
    expected = read_survey(path)
    raw = path.read_bytes()
    cut = tmp_path / ("cut" + path.suffix)
    cut.write_bytes(raw[: int(0.6 * len(raw))])
    with caplog.at_level(logging.WARNING):
        survey = read_survey(cut, RECOVER)
    n = len(survey)
    assert 60 < n < 300
    np.testing.assert_array_equal(survey.field, expected.field[:n])
    np.testing.assert_array_equal(survey.positions, expected.positions[:n])
    assert "recovered, but for" in caplog.text


def test_a_whole_log_loses_nothing_when_recovered(whole):
    path, messages = whole
    found, losses = messages_of(path, recover=True)
    assert set(found) == messages
    assert losses == []


def test_a_bag_whose_recorder_was_killed_gives_all_that_was_written(made, flight, tmp_path):
    """Recorders write the head of a chunk last; until then it declares no bytes, and its messages stand behind it."""
    path = made.WRITERS["ROS 1 bag"](tmp_path, flight.series)
    messages = set(messages_of(path)[0])
    raw = bytearray(path.read_bytes())
    mark = b"\x04\x00\x00\x00op=\x05"
    last = raw.rindex(mark)
    size = raw.index(b"size=", raw.rindex(b"compression=")) + 5
    n = int.from_bytes(raw[size : size + 4], "little")
    data = max(size + 4, last + len(mark))  # the length of the data stands behind the last field
    assert int.from_bytes(raw[data : data + 4], "little") == n
    raw[size : size + 4] = raw[data : data + 4] = bytes(4)
    index = raw.index(b"index_pos=") + 10
    raw[index : index + 8] = bytes(8)
    path.write_bytes(raw[: data + 4 + n])
    with pytest.raises(DataFormatError, match=r"not indexed.*--recover"):
        messages_of(path)
    found, losses = messages_of(path, recover=True)
    assert set(found) == messages
    assert losses == []


@pytest.fixture
def database(made, flight, tmp_path):
    folder = made.ros2(tmp_path / "bag", flight.series)
    return folder / "bag.db3", set(messages_of(folder)[0])


def test_a_damaged_page_of_a_database_is_passed_over(database, tmp_path):
    path, messages = database
    raw = bytearray(path.read_bytes())
    size = int.from_bytes(raw[16:18], "big")
    middle = (len(raw) // size // 2) * size
    raw[middle : middle + size] = b"\xff" * size
    path.write_bytes(raw)
    with pytest.raises(DataFormatError, match="--recover"):
        messages_of(path)
    found, losses = messages_of(path, recover=True)
    assert set(found) <= messages
    assert len(found) > 0.8 * len(messages)
    assert "lie on damaged pages" in losses[0].words


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_database_cut_off_gives_its_first_messages(share, database):
    path, messages = database
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(DataFormatError, match="--recover"):
        messages_of(path)
    found, losses = messages_of(path, recover=True)
    assert set(found) <= messages
    assert len(found) > (share - 0.3) * len(messages)
    assert losses


def test_a_missing_file_of_a_split_bag_is_named(made, flight, tmp_path):
    folder = made.ros2(tmp_path / "bag", flight.series)
    path = folder / "metadata.yaml"
    path.write_text(path.read_text().replace("- bag.db3", "- bag.db3\n  - bag_1.db3", 1))
    with pytest.raises(DataFormatError, match=r"bag_1[.]db3.*--recover"):
        read_survey(folder)
    assert len(read_survey(folder, RECOVER)) == 300


def test_messages_that_hold_no_numbers_are_left_out_only_when_asked(made, flight, tmp_path, caplog):
    mag, odom = flight.series
    values = mag.values.copy()
    values[[5, 9]] = np.nan
    path = made.mcap(tmp_path / "log.mcap", [made.replace(mag, values=values), odom])
    with pytest.raises(DataFormatError, match=r"/imu/mag, message 5: holds NaN or infinity \(2 such messages"):
        read_survey(path)
    assert len(read_survey(path, RECOVER)) == 298
    assert "left out 2 messages" in caplog.text


def test_tables_that_compute_are_never_asked(tmp_path):
    """A view could run without end."""
    path = tmp_path / "trap.db3"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
    database.execute(
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(100) AS data FROM n"
    )
    database.commit()
    database.close()
    with pytest.raises(MagmatchError, match="without table messages"):
        read_survey(path)
