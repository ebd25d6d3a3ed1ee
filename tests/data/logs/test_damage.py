# SPDX-License-Identifier: BSD-3-Clause
"""Damaged logs: refused in one line that names the file, what was found and the tool that mends it."""

import shutil
import sqlite3

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.errors import DataFormatError, MagmatchError

CHUNKED = [
    "ROS 1 bag", "ROS 1 bag, bz2", "ROS 1 bag, lz4", "MCAP of ROS 2", "MCAP, lz4", "MCAP, not compressed",
    "MCAP without chunks", "MCAP without summary",
]  # fmt: skip
TOOLS = {".bag": "rosbag reindex mends it", ".mcap": "mcap recover mends it"}


@pytest.fixture(params=CHUNKED)
def whole(request, made, flight, tmp_path):
    """A log with small chunks."""
    return made.WRITERS[request.param](tmp_path, flight.series)


def names_the_tool(path, refusal):
    """Whether a file is refused as it should be, which `--recover` does not change."""
    words = refusal(path)
    assert words == refusal(path, recover=True)
    assert words.startswith(str(path))
    assert TOOLS[path.suffix] in words
    return words


@pytest.mark.parametrize("share", [0.0, 0.15, 0.4, 0.7, 0.95])
def test_a_log_that_is_cut_off_names_what_mends_it(share, whole, refusal):
    raw = whole.read_bytes()
    whole.write_bytes(raw[: max(13, int(share * len(raw)))])
    names_the_tool(whole, refusal)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_hole_in_chunks_names_what_mends_it(share, whole, refusal):
    raw = bytearray(whole.read_bytes())
    start = int(share * len(raw))
    raw[start : start + 500] = bytes(range(250)) * 2
    whole.write_bytes(raw)
    names_the_tool(whole, refusal)


def test_a_bag_whose_recorder_was_killed_is_to_be_reindexed(made, flight, tmp_path, refusal):
    path = made.WRITERS["ROS 1 bag"](tmp_path, flight.series)
    raw = bytearray(path.read_bytes())
    index = raw.index(b"index_pos=") + 10
    raw[index : index + 8] = bytes(8)
    path.write_bytes(raw)
    assert "Bag is not indexed" in names_the_tool(path, refusal)


def test_a_bag_of_an_old_version_is_to_be_migrated(tmp_path, refusal):
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(99))
    words = "expected a bag of version 2.0, found '#ROSBAG V1.2' (rosbag migrates it)"
    assert words in refusal(tmp_path / "log.bag")


@pytest.fixture
def database(made, flight, tmp_path):
    return made.ros2(tmp_path / "bag", flight.series) / "bag.db3"


def test_a_damaged_page_of_a_database_names_what_mends_it(database, refusal):
    raw = bytearray(database.read_bytes())
    size = int.from_bytes(raw[16:18], "big")
    middle = (len(raw) // size // 2) * size
    raw[middle : middle + size] = b"\xff" * size
    database.write_bytes(raw)
    assert "sqlite3 (.recover), and then ros2 bag reindex, mends it" in refusal(database.parent, recover=True)


def test_what_the_recorder_left_in_a_journal_is_read(database, tmp_path):
    expected = read_survey(database)
    writer = sqlite3.connect(database)
    writer.execute("PRAGMA journal_mode = WAL")
    writer.execute("PRAGMA wal_autocheckpoint = 0")
    rows = writer.execute("SELECT * FROM messages").fetchall()
    writer.execute("DELETE FROM messages")
    writer.commit()
    writer.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    writer.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(rows[0]))})", rows)
    writer.commit()
    (tmp_path / "killed").mkdir()
    for name in ("bag.db3", "bag.db3-wal"):  # as they lie while the recorder writes
        shutil.copy(database.parent / name, tmp_path / "killed" / name)
    writer.close()
    np.testing.assert_array_equal(read_survey(tmp_path / "killed" / "bag.db3").field, expected.field)


def test_an_index_that_lacks_messages_is_not_believed(made, flight, tmp_path):
    """The recorder of a chunk without an index of its messages, or of messages outside any chunk."""
    from mcap.writer import IndexType

    expected = read_survey(made.mcap(tmp_path / "log.mcap", flight.series))
    kinds = IndexType.ALL & ~IndexType.MESSAGE
    survey = read_survey(made.mcap(tmp_path / "other.mcap", flight.series, index_types=kinds))
    np.testing.assert_array_equal(survey.field, expected.field)


def test_messages_that_hold_no_numbers_are_left_out_only_when_asked(made, flight, tmp_path, caplog):
    mag, odom = flight.series
    values = mag.values.copy()
    values[[5, 9]] = np.nan
    path = made.mcap(tmp_path / "log.mcap", [made.replace(mag, values=values), odom])
    with pytest.raises(DataFormatError, match=r"/imu/mag, message 5: holds NaN or infinity \(2 such messages"):
        read_survey(path)
    assert len(read_survey(path, SurveyFormat(recover=True))) == 298
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
