# SPDX-License-Identifier: BSD-3-Clause
"""Open a recorder log, whatever its container."""

from importlib.util import find_spec
from pathlib import Path

from magmatch.data.logs.log import Log
from magmatch.data.tables.text import is_folder, read_bytes
from magmatch.errors import DataFormatError, MissingExtraError

NEEDED = ("rosbags", "mcap", "lz4", "zstandard")


def open_log(path: str | Path, *, recover: bool = False) -> Log:
    """Open a ROS 1 bag, a ROS 2 bag (folder or file) or an MCAP file, told by content; to be closed when done.

    ``recover`` leaves out damaged pieces and notes them (`Log.losses`) instead of refusing. Raises `DataFormatError`
    where there is no such log or a damaged one, which then names ``--recover``; `MissingExtraError` without ``ros``.
    """
    if any(find_spec(name) is None for name in NEEDED):
        feature = "reading a ROS bag or MCAP file"
        raise MissingExtraError(feature, "ros")
    from magmatch.data.logs.mcap_log import McapLog
    from magmatch.data.logs.ros1_bag import Ros1Log
    from magmatch.data.logs.ros2_bag import open_ros2_folder
    from magmatch.data.logs.sqlite_log import SqliteLog

    if is_folder(path):
        return open_ros2_folder(path, lambda part: open_log(part, recover=recover), recover=recover)
    head = read_bytes(path, 16)
    for signature, kind in ((b"\x89MCAP", McapLog), (b"#ROSBAG V", Ros1Log), (b"SQLite format 3\0", SqliteLog)):
        if head.startswith(signature):
            return kind(path, recover=recover)
    raise DataFormatError(path, "is no ROS 1 bag, ROS 2 bag or MCAP file, or its first bytes are damaged")
