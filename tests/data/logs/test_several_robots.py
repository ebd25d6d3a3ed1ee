# SPDX-License-Identifier: BSD-3-Clause
"""Several robots in one log, whose frames have the same names: each keeps its own poses and mount."""

import numpy as np
import pytest

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.read import list_topics
from magmatch.data.read import read_survey

TF = "tf2_msgs/msg/TFMessage"
MOUNTS = {1: [1.0, 0, 0, 0, 0, 0, 1], 2: [0, 0, 3.0, 0, 0, 0.6, 0.8]}


@pytest.fixture
def robot(made, flight):
    """Topics of one robot: the second has more readings of the field, the first more poses."""

    def make(k, name="/robot{}", tf=False):
        mag, odom = flight.series
        space = name.format(k)
        every = slice(None, None, 3 - k), slice(None, None, k)
        shifted = odom.values + 50.0 * (k - 1) * np.eye(7)[1]
        topic, kind = (f"{space}/tf", TF) if tf else (f"{space}/odom", odom.type)
        return [
            made.replace(mag, topic=f"{space}/imu/mag", **_thinned(mag, every[0])),
            made.replace(odom, topic=topic, type=kind, child="base", **_thinned(odom, every[1], shifted)),
            made.Series(f"{space}/tf_static", TF, odom.log_ns[:1] + k, [MOUNTS[k]], frame="base", child="mag_link"),
        ]

    return make


def _thinned(series, which, values=None):
    values = series.values if values is None else values
    return {"log_ns": series.log_ns[which], "stamp_ns": series.stamp_ns[which], "values": values[which]}


def same(survey, expected):
    np.testing.assert_array_equal(survey.positions, expected.positions)
    np.testing.assert_array_equal(survey.field, expected.field)


@pytest.mark.parametrize("tf", [False, True], ids=["odometry", "tf"])
@pytest.mark.parametrize("k", [1, 2])
def test_each_robot_has_its_own_poses_and_mount(k, tf, robot, saved):
    expected = read_survey(saved(*robot(k, tf=tf)))
    path = saved(*robot(1, tf=tf), *robot(2, tf=tf))
    poses = f"/robot{k}/tf" if tf else f"/robot{k}/odom"
    for named in ({"mag_topic": f"/robot{k}/imu/mag"}, {"pose_topic": poses}):
        layout = SurveyFormat(**named)
        same(read_survey(path, layout), expected)
        assert list_topics(path, layout)[1] == {"field": f"/robot{k}/imu/mag", "poses": poses}


def test_topics_that_nobody_named_are_those_of_one_robot(robot, saved):
    _, chosen = list_topics(saved(*robot(1), *robot(2)), SurveyFormat())
    assert {name.split("/")[1] for name in chosen.values()} in ({"robot1"}, {"robot2"})


def test_what_tf_says_of_the_robot_stands_before_the_odometry_of_another(robot, saved):
    expected = read_survey(saved(*robot(2, tf=True)))
    same(read_survey(saved(*robot(1), *robot(2, tf=True)), SurveyFormat(mag_topic="/robot2/imu/mag")), expected)


def test_what_is_left_out_of_tf_is_said(robot, saved, caplog, tmp_path):
    read_survey(saved(*robot(1), *robot(2)), SurveyFormat(mag_topic="/robot2/imu/mag"))
    words = "read are /robot2/tf_static, of the robot with /robot2/imu/mag, not /robot1/tf_static (--pose-topic)"
    assert words in caplog.text
    caplog.clear()
    read_survey(tmp_path / "log.mcap", SurveyFormat(mag_topic="/robot2/imu/mag", pose_topic="/robot2/odom"))
    assert "read are" not in caplog.text


def test_tf_above_all_robots_serves_each(robot, saved, made, caplog):
    mag, odom, static = robot(2)
    expected = read_survey(saved(mag, odom, static))
    mast = made.replace(static, child="mast")
    down = np.array([0, 0, 0, 0, 0, 0, 1.0])
    rest = made.replace(static, topic="/robot2/tf_static", frame="mast", values=[down])
    survey = read_survey(saved(mag, odom, made.replace(mast, topic="/tf_static"), rest))
    np.testing.assert_allclose(survey.field, expected.field, rtol=0, atol=1e-18)  # T
    assert "topics of frames" not in caplog.text


def test_topics_that_place_one_frame_differently_are_said(robot, saved, made, caplog):
    mag, odom, static = robot(2)
    read_survey(saved(mag, odom, static, made.replace(static, topic="/tf_static")))
    assert "differently" not in caplog.text
    read_survey(saved(mag, odom, static, made.replace(static, topic="/tf_static", values=[MOUNTS[1]])))
    assert "/robot2/tf_static and /tf_static place 'mag_link' on 'base' differently" in caplog.text


def test_two_trees_of_tf_that_move_one_frame_differently_are_said(robot, saved, made, caplog):
    mag, tf, static = robot(2, tf=True)
    relayed = made.replace(tf, topic="/tf", **_thinned(tf, slice(None, None, 3)))
    expected = read_survey(saved(mag, tf, static))
    same(read_survey(saved(mag, tf, static, relayed)), expected)
    assert "differently" not in caplog.text
    same(read_survey(saved(mag, tf, static, made.replace(tf, topic="/tf", values=tf.values + 1e-3 * np.eye(7)[0]))),
         expected)  # fmt: skip
    assert "/robot2/tf and /tf place 'base' on 'map' differently; /robot2/tf is read" in caplog.text


def test_a_static_mount_that_changed_is_said(robot, saved, made, caplog):
    mag, odom, static = robot(2)
    changed = made.replace(static, log_ns=odom.log_ns[[0, 60]], values=[MOUNTS[1], MOUNTS[2]], stamp_ns=None)
    same(read_survey(saved(mag, odom, changed)), read_survey(saved(mag, odom, static)))
    assert "/robot2/tf_static place 'mag_link' on 'base' differently; the last one holds" in caplog.text
    caplog.clear()
    read_survey(saved(mag, odom, changed), SurveyFormat(extrinsic="0 0 3"))
    assert "differently" not in caplog.text
