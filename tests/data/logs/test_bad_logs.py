# SPDX-License-Identifier: BSD-3-Clause
"""Logs that cannot be a survey, by name: each is refused in one line that says what is wrong and what to do."""

import numpy as np
import pytest

from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError, DataFormatError

SECOND = 1_000_000_000


# --- Whole logs that hold no survey --------------------------------------------------------------------------------


def changed(series, k, **fields):
    from dataclasses import replace

    return [replace(s, **fields) if i == k else s for i, s in enumerate(series)]


def with_value(series, k, row, value):
    values = series[k].values.copy()
    values[row] = value
    return changed(series, k, values=values)


def set_back(series, k):
    stamps = series[k].stamp_ns.copy()
    stamps[60:] -= 5 * SECOND
    return changed(series, k, stamp_ns=stamps)


CONTENTS = {
    "no field topic": (lambda s: s[1:], {}, "expected a field topic"),
    "no pose topic": (lambda s: s[:1], {}, "expected a pose topic"),
    "neither": (lambda s: changed(s[:1], 0, type="std_msgs/msg/String"), {}, "expected a field topic"),
    "NaN in the field": (lambda s: with_value(s, 0, 7, np.nan), {}, "/imu/mag, message 7: holds NaN"),
    "infinity in a pose": (lambda s: with_value(s, 1, (4, 2), np.inf), {}, "/odom, message 4: holds NaN or infinity"),
    "zero quaternion": (lambda s: with_value(s, 1, (9, slice(3, 7)), 0), {}, "/odom, message 9: expected a unit"),
    "all poses zero": (lambda s: changed(s, 1, values=np.zeros((130, 7))), {}, "130 such messages"),
    "a number beyond reason": (lambda s: with_value(s, 1, (3, 0), 1e300), {}, "message 3: holds a number of 1e+300"),
    "field clock set back": (lambda s: set_back(s, 0), {}, "/imu/mag, message 60: time runs backward"),
    "pose clock set back": (lambda s: set_back(s, 1), {}, "/odom, message 60: time runs backward"),
    "no shared time": (
        lambda s: changed(s, 1, stamp_ns=s[1].stamp_ns + 900 * SECOND),
        {},
        "no sample lies within the trajectory",
    ),
    "one pose": (
        lambda s: changed(s, 1, log_ns=s[1].log_ns[:1], stamp_ns=None, values=s[1].values[:1]),
        {},
        "at least two poses, found 1",
    ),
    "unknown field topic": (lambda s: s, {"mag_topic": "/mag"}, "--mag-topic /mag: no such topic"),
    "unknown pose topic": (lambda s: s, {"pose_topic": "/pose"}, "--pose-topic /pose: no such topic"),
    "field topic of another type": (lambda s: s, {"mag_topic": "/odom"}, "expected a field topic"),
    "pose topic of another type": (lambda s: s, {"pose_topic": "/imu/mag"}, "expected a pose topic"),
    "frames without tf": (lambda s: s, {"pose_frames": "map,base"}, "tf does not connect 'base' to 'map'"),
    "positions only": (
        lambda s: changed(s, 1, type="geometry_msgs/msg/PointStamped", values=s[1].values[:, :3]),
        {},
        "cannot be turned",
    ),
    "static tf only": (
        lambda s: changed(s, 1, topic="/tf_static", type="tf2_msgs/msg/TFMessage"),
        {},
        "expected a pose topic",
    ),
    "tf that lacks the sensor": (
        lambda s: changed(s, 1, topic="/tf", type="tf2_msgs/msg/TFMessage", child="wheel"),
        {},
        "tf does not know 'mag_link'",
    ),
}


@pytest.mark.parametrize("case", CONTENTS)
def test_a_whole_log_without_a_survey_says_what_it_lacks(case, made, flight, tmp_path, refusal):
    change, settings, words = CONTENTS[case]
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, change(flight.series))
    assert words in refusal(path, **settings)


EXTRINSICS = {
    "eight numbers": ("1 2 3 4 5 6 7 8", "found 8 numbers"),
    "NaN": ("0 0 nan 0 0 0 1", "NaN"),
    "zero quaternion": ("0 0 0 0 0 0 0", "length 0"),
    "long quaternion": ("0 0 0 1 1 1 1", "length 2"),
    "no such file": ("nowhere.yaml", "no such file"),
    "no YAML": ("!a: [", "expected the extrinsic"),
    "no rotation": ("translation: [1, 2, 3]", "expected translation"),
    "no unit": ("translation: [1, 2, 3]\nrotation: [0, 0, 0, 5]", "length 5"),
    "values repeated without end": ("translation: &a [[*a, *a], *a]\nrotation: *a", "is not YAML"),
    "a Python object": ("translation: !!python/object/apply:os.abort []\nrotation: 1", "is not YAML"),
}


@pytest.mark.parametrize("case", EXTRINSICS)
def test_an_extrinsic_that_is_none_is_refused(case, made, flight, tmp_path, refusal):
    text, words = EXTRINSICS[case]
    if text.startswith(("!", "[", "translation")):
        (tmp_path / "extrinsic.yaml").write_text(text)
        text = str(tmp_path / "extrinsic.yaml")
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series)
    assert words in refusal(path, (DataFormatError, ConfigurationError), extrinsic=text)


@pytest.mark.parametrize("name", ["log.csv", "log.db3", "log", "log.bag"])
def test_the_name_of_a_log_does_not_matter(name, made, flight, tmp_path):
    path = made.WRITERS["MCAP of ROS 2"](tmp_path, flight.series).rename(tmp_path / name)
    assert len(read_survey(path)) == 300
