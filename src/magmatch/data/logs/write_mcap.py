# SPDX-License-Identifier: BSD-3-Clause
"""Write a survey as MCAP that ROS 2 tools read: the field and the poses it was measured at."""

from pathlib import Path
from typing import Any

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.data.survey import Survey
from magmatch.data.tables.times import SECOND, nanoseconds_of
from magmatch.errors import SurveyError, import_extra
from magmatch.number_text import told

FIELD_TOPIC, POSE_TOPIC = "/magmatch/field", "/magmatch/pose"
FIELD, POSE, POINT = (
    "sensor_msgs/msg/MagneticField",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PointStamped",
)


def write_mcap(survey: Survey, path: str | Path) -> None:
    """Write a survey as MCAP: ``sensor_msgs/MagneticField`` and ``geometry_msgs/PoseStamped``, CDR.

    Field vectors stand in the survey's frame, and their header says so; positions without orientations become
    ``geometry_msgs/PointStamped``. Times are rounded to whole nanoseconds; `SurveyError` where there are none, or
    none that ROS can state. An existing file is replaced only once the new one is complete.
    """
    mcap, typesys = (import_extra(name, "writing MCAP", "ros") for name in ("mcap.writer", "rosbags.typesys"))
    stamps, store = _stamps(survey), typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    new: dict[str, Any] = {name.rsplit("/", 1)[1]: kind for name, kind in store.types.items()}
    quaternions = None if survey.orientations is None else survey.orientations.as_quat().tolist()
    kinds = {FIELD_TOPIC: FIELD, POSE_TOPIC: POINT if quaternions is None else POSE}
    with atomic_write(path) as stream:
        writer = mcap.Writer(stream, compression=mcap.CompressionType.ZSTD)
        writer.start("ros2")
        channels = {}
        for topic, kind in kinds.items():
            definition = store.generate_msgdef(kind, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", definition)
            )
        no_covariance = np.zeros(9)
        rows = zip(stamps, survey.field.tolist(), survey.positions.tolist(), strict=True)
        for i, (stamp, b, p) in enumerate(rows):
            header = new["Header"](new["Time"](*divmod(stamp, SECOND)), survey.frame or "survey")
            pose = new["PointStamped"](header, new["Point"](*p))
            if quaternions is not None:
                pose = new["PoseStamped"](header, new["Pose"](new["Point"](*p), new["Quaternion"](*quaternions[i])))
            field = new["MagneticField"](header, new["Vector3"](*b), no_covariance)
            for topic, message in ((POSE_TOPIC, pose), (FIELD_TOPIC, field)):
                data = bytes(store.serialize_cdr(message, kinds[topic]))
                writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()


def _stamps(survey: Survey) -> list[int]:
    """Whole nanoseconds, as ROS can state them."""
    if survey.times is None:
        msg = f"{survey.name}: has no times, which MCAP needs"
        raise SurveyError(msg)
    if survey.times[0] < 0 or survey.times[-1] >= 2**31:
        first, last = told(survey.times[0]), told(survey.times[-1])
        msg = f"{survey.name}: times run from {first} to {last} s, ROS knows 0 to 2^31"
        raise SurveyError(msg)
    return [int(stamp) for stamp in nanoseconds_of(survey.times)]
