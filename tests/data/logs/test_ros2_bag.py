# SPDX-License-Identifier: BSD-3-Clause
"""ROS 2 bag folders made wrong, by name: each is refused in one line that says what is wrong and what to do."""

import sqlite3

import pytest
import yaml

from magmatch.data.read import read_survey

MAG = "sensor_msgs/msg/MagneticField"


def about(folder, **changes):
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"] |= changes
    path.write_text(yaml.safe_dump(content))


def run_sql(folder, *statements):
    database = sqlite3.connect(folder / "log-db3.db3")
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()


FOLDERS = {
    "metadata that is no YAML": (lambda f: (f / "metadata.yaml").write_text("a: [b"), "is not YAML"),
    "metadata repeated without end": (
        lambda f: (f / "metadata.yaml").write_text("rosbag2_bagfile_information: &a {x: [*a, *a]}"),
        "repeats values by name",
    ),
    "metadata of something else": (lambda f: (f / "metadata.yaml").write_text("a: b"), "rosbag2_bagfile_information"),
    "a file elsewhere": (lambda f: about(f, relative_file_paths=["/etc/passwd"]), "outside the folder"),
    "files that are no names": (lambda f: about(f, relative_file_paths=[1]), "list of names"),
    "a missing file": (lambda f: about(f, relative_file_paths=["a.db3"]), "not in the folder; 'ros2 bag reindex'"),
    "files compressed as a whole": (lambda f: (f / "x.db3.zstd").write_bytes(b"x"), "unzstd x.db3.zstd"),
    "messages compressed otherwise": (
        lambda f: about(f, compression_mode="message", compression_format="lz4"),
        "expected zstd",
    ),
    "messages said to be compressed": (
        lambda f: about(f, compression_mode="message", compression_format="zstd"),
        "says that messages are compressed, found one that is not",
    ),
    "a name with a NUL": (lambda f: about(f, relative_file_paths=["a\0.db3"]), "outside the folder"),
    "no column of types": (lambda f: run_sql(f, "ALTER TABLE topics RENAME COLUMN type TO kind"), "damaged ROS 2"),
    "messages of no topic": (lambda f: run_sql(f, "UPDATE messages SET topic_id = 99"), "holds no messages"),
    "a database of something else": (lambda f: run_sql(f, "DROP TABLE messages"), "without table messages"),
    "no topics": (lambda f: run_sql(f, "DELETE FROM topics"), "expected a field topic"),
    "no messages": (lambda f: run_sql(f, "DELETE FROM messages"), "holds no messages"),
    "data of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET data = 'text'"),
        "without a whole number as time stamp, or data",
    ),
    "stamps of another kind": (
        lambda f: run_sql(f, "UPDATE messages SET timestamp = 'now'"),
        "time stamp is no whole number",
    ),
    "names of another kind": (lambda f: run_sql(f, "UPDATE topics SET name = x'ff'"), "other things than names"),
    "payloads of zeros": (lambda f: run_sql(f, "UPDATE messages SET data = zeroblob(50)"), "message 0: "),
    "another serialisation": (
        lambda f: run_sql(f, "UPDATE topics SET serialization_format = 'xml'"),
        "encoded as 'xml'",
    ),
    "types exchanged": (
        lambda f: run_sql(f, f"UPDATE topics SET type = '{MAG}' WHERE name = '/odom'"),
        "/odom, message 0: ",
    ),
}


@pytest.mark.parametrize("case", FOLDERS)
def test_a_ros2_bag_made_wrong_is_refused(case, made, flight, tmp_path, refusal):
    damage, words = FOLDERS[case]
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    damage(folder)
    settings = {"mag_topic": "/odom", "pose_topic": "/odom"} if case == "types exchanged" else {}
    if settings:
        settings = {"mag_topic": "/odom", "trajectory": tmp_path / "poses.tum"}
        flight.trajectory().save(tmp_path / "poses.tum")
    assert words in refusal(folder, **settings)


def test_a_bag_without_metadata_is_read_by_its_files(made, flight, tmp_path):
    folder = made.WRITERS["ROS 2 bag, sqlite3"](tmp_path, flight.series)
    (folder / "metadata.yaml").unlink()
    assert len(read_survey(folder)) == 300
    assert len(read_survey(folder / "log-db3.db3")) == 300
