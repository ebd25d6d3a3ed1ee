# SPDX-License-Identifier: BSD-3-Clause
"""Open a recorder log, whatever its container."""

from pathlib import Path

from magmatch.data.logs.chunked import ChunkedLog
from magmatch.data.logs.log import Log
from magmatch.data.logs.mcap import MAGIC as MCAP_MAGIC
from magmatch.data.logs.mcap import McapContainer
from magmatch.data.logs.ros1_bag import Ros1Container
from magmatch.data.logs.ros2_bag import open_ros2_folder
from magmatch.data.logs.sqlite_log import SqliteLog
from magmatch.data.tables.text import is_folder, read_bytes
from magmatch.errors import DataFormatError


def open_log(path: str | Path, *, recover: bool = False) -> Log:
    """Open a ROS 1 bag, a ROS 2 bag (folder or file) or an MCAP file, told by content.

    Parameters
    ----------
    path : path
        The file or folder.
    recover : bool
        Pass over damaged pieces and note them (`Log.losses`), instead of refusing.

    Returns
    -------
    Log
        Close it when done.

    Raises
    ------
    DataFormatError
        No such log, or a damaged one; then it names ``--recover``.
    """
    if is_folder(path):
        return open_ros2_folder(path, lambda part: open_log(part, recover=recover), recover=recover)
    head = read_bytes(path, 16)
    if head.startswith(MCAP_MAGIC):
        return ChunkedLog(path, McapContainer(), recover=recover)
    if head.startswith(b"#ROSBAG V"):
        return ChunkedLog(path, Ros1Container(), recover=recover)
    if head == b"SQLite format 3\0":
        return SqliteLog(path, recover=recover)
    raise DataFormatError(path, "is no ROS 1 bag, ROS 2 bag or MCAP file, or its first bytes are damaged")
