# SPDX-License-Identifier: BSD-3-Clause
"""Write a survey as MCAP that ROS 2 tools read: the field and the poses it was measured at."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.survey import Survey
from magmatch.data.tables.nanoseconds import SECOND, nanoseconds_of
from magmatch.errors import MissingExtraError, SurveyError

FIELD_TOPIC, POSE_TOPIC = "/magmatch/field", "/magmatch/pose"
_HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
_VECTOR = """
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
_POINT = _VECTOR.replace("Vector3", "Point")
_POSE = """
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w"""
DEFINITIONS = {
    "sensor_msgs/msg/MagneticField": "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\n"
    "float64[9] magnetic_field_covariance" + _HEADER + _VECTOR,
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose" + _HEADER + _POSE + _POINT,
    "geometry_msgs/msg/PointStamped": "std_msgs/Header header\ngeometry_msgs/Point point" + _HEADER + _POINT,
}


def write_mcap(survey: Survey, path: str | Path) -> None:
    """Write a survey as MCAP: ``sensor_msgs/MagneticField`` and ``geometry_msgs/PoseStamped``, CDR.

    Field vectors stand in the survey's frame, and their header says so; positions without orientations become
    ``geometry_msgs/PointStamped``. Times are rounded to whole nanoseconds.

    Parameters
    ----------
    survey : Survey
        With times.
    path : path
        Where; an existing file is replaced only once the new one is complete.

    Raises
    ------
    SurveyError
        It has no times, or times that ROS cannot state.
    MissingExtraError
        Writing MCAP needs the extra ``ros``.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        feature = "writing MCAP"
        raise MissingExtraError(feature, "ros") from None
    stamps = _stamps(survey)
    poses = survey.positions
    kind = "geometry_msgs/msg/PointStamped"
    if survey.orientations is not None:
        kind = "geometry_msgs/msg/PoseStamped"
        poses = np.hstack([poses, survey.orientations.as_quat()])
    with atomic_write(path) as stream:
        writer: Any = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2")
        field_channel = _register(writer, FIELD_TOPIC, "sensor_msgs/msg/MagneticField")
        pose_channel = _register(writer, POSE_TOPIC, kind)
        for stamp, head, b, pose in _rows(survey, stamps, poses):
            writer.add_message(pose_channel, stamp, head + pose, stamp)
            writer.add_message(field_channel, stamp, head + b + bytes(72), stamp)
        writer.finish()


def _register(writer: Any, topic: str, kind: str) -> int:
    schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
    return int(writer.register_channel(topic, "cdr", schema))


def _rows(survey: Survey, stamps: list[int], poses: np.ndarray) -> Iterator[tuple[int, bytes, bytes, bytes]]:
    """Per sample: stamp, serialised header, field, pose."""
    name = (survey.frame or "survey").encode() + b"\0"
    field = survey.field.astype("<f8")
    packed = poses.astype("<f8")
    for i, stamp in enumerate(stamps):
        head = struct.pack("<4BiII", 0, 1, 0, 0, *divmod(stamp, SECOND), len(name)) + name
        head += bytes(-(len(head) - 4) % 8)  # doubles are aligned behind the four bytes of CDR
        yield stamp, head, field[i].tobytes(), packed[i].tobytes()


def _stamps(survey: Survey) -> list[int]:
    """Whole nanoseconds, as ROS can state them."""
    if survey.times is None:
        msg = f"{survey.name}: has no times, which MCAP needs"
        raise SurveyError(msg)
    if survey.times[0] < 0 or survey.times[-1] >= 2**31:
        msg = f"{survey.name}: times run from {survey.times[0]:.9g} to {survey.times[-1]:.9g} s, ROS knows 0 to 2^31"
        raise SurveyError(msg)
    return [int(stamp) for stamp in nanoseconds_of(survey.times)]
