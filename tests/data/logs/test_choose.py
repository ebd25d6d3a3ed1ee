# SPDX-License-Identifier: BSD-3-Clause
"""Which topics are read, where the sensor sits, and whose clock counts."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.logs.read import list_topics
from magmatch.data.read import read_survey
from magmatch.errors import ConfigurationError, DataFormatError

SECOND = 1_000_000_000
LEVER = np.array([[0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8]])
POSE_TYPES = {
    "Odometry": "nav_msgs/msg/Odometry",
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "TransformStamped": "geometry_msgs/msg/TransformStamped",
}
TF = "tf2_msgs/msg/TFMessage"


def static(made, flight, values, frame, child):
    return made.Series("/tf_static", TF, flight.pose_ns[:1], values, frame=frame, child=child)


@pytest.mark.parametrize("name", POSE_TYPES)
def test_poses_of_every_type_give_the_same_survey(name, made, flight, saved, tmp_path):
    mag, odom = flight.series
    expected = read_survey(saved(mag, odom))
    other = made.replace(odom, type=POSE_TYPES[name], topic="/p")
    for write in (made.ros1, made.mcap):
        path = tmp_path / f"other-{write.__name__}"
        survey = read_survey(write(path, [mag, other]))
        np.testing.assert_array_equal(survey.positions, expected.positions)
        np.testing.assert_array_equal(survey.field, expected.field)


def test_most_messages_in_shared_time_win_then_names(made, flight, saved):
    mag, odom = flight.series
    slow = made.replace(odom, topic="/a_slow", log_ns=odom.log_ns[::2], stamp_ns=None, values=odom.values[::2])
    late = made.replace(odom, topic="/a_late", log_ns=odom.log_ns + 4 * SECOND, stamp_ns=None)
    twin = made.replace(odom, topic="/z_twin")
    few = made.replace(mag, topic="/a_mag", log_ns=mag.log_ns[::3], stamp_ns=None, values=mag.values[::3])
    path = saved(few, mag, slow, late, twin, odom)
    topics, chosen = list_topics(path, SurveyFormat())
    assert chosen == {"field": "/imu/mag", "poses": "/odom"}
    assert [topic.count for topic in topics if topic.name == "/a_mag"] == [100]
    _, chosen = list_topics(path, SurveyFormat(mag_topic="/a_mag", pose_topic="a_slow"))
    assert chosen == {"field": "/a_mag", "poses": "/a_slow"}
    assert len(read_survey(path, SurveyFormat(mag_topic="/a_mag"))) == 100


def test_a_choice_between_topics_is_said(made, flight, saved, caplog):
    mag, odom = flight.series
    path = saved(mag, made.replace(mag, topic="/arm/mag"), odom, made.replace(odom, topic="/slam/odom"))
    read_survey(path)
    assert "topic of the field: /arm/mag is read, not /imu/mag (--mag-topic)" in caplog.text
    assert "topic of poses: /odom is read, not /slam/odom (--pose-topic)" in caplog.text
    caplog.clear()
    read_survey(path, SurveyFormat(mag_topic="/imu/mag", pose_topic="/odom"))
    assert "is read, not" not in caplog.text


SETS_POSES = ["/goal_pose", "/mavros/setpoint_position/local", "/initialpose", "/Target/pose", "/waypoints"]


def goals_of(made, odom, name):
    """As many poses as the odometry has, and others."""
    return made.replace(odom, type=POSE_TYPES["PoseStamped"], topic=name, values=odom.values[::-1])


def test_goals_are_no_path_where_a_topic_or_tf_has_one(made, flight, saved, caplog):
    mag, odom = flight.series
    goals = [goals_of(made, odom, name) for name in SETS_POSES]
    long_before = {"log_ns": mag.log_ns[0] - np.array([9, 5]) * SECOND, "stamp_ns": None, "values": odom.values[:2]}
    slow = made.replace(odom, topic="/pose", log_ns=odom.log_ns[::2], stamp_ns=None, values=odom.values[::2])
    tf = made.replace(odom, topic="/tf", type=TF, child="mag_link")
    for path in (slow, tf):
        expected = read_survey(saved(mag, path))
        for sets in (goals, [made.replace(goal, **long_before) for goal in goals]):
            np.testing.assert_array_equal(read_survey(saved(mag, path, *sets)).positions, expected.positions)
    assert "goals or starts" not in caplog.text


@pytest.mark.parametrize("name", SETS_POSES)
def test_goals_are_a_path_where_they_are_asked_for_or_alone(name, made, flight, saved, caplog):
    mag, odom = flight.series
    goals = goals_of(made, odom, name)
    asked = read_survey(saved(mag, odom, goals), SurveyFormat(pose_topic=name))
    assert "goals or starts" not in caplog.text
    alone = read_survey(saved(mag, goals))
    np.testing.assert_array_equal(alone.positions, asked.positions)
    assert f"{name} is read: expected the path of a body, found only what looks like goals or starts" in caplog.text


def test_an_extrinsic_is_where_the_sensor_sits_on_the_body(made, flight, saved):
    mag, odom = flight.series
    survey = read_survey(saved(mag, odom), SurveyFormat(extrinsic="0.1 -0.2 0.3 0 0.6 0 0.8"))
    body, poses = read_survey(saved(mag, made.replace(odom, child="mag_link"))), flight.trajectory()
    lever = poses.orientations.apply([0.1, -0.2, 0.3])
    expected = [np.interp(survey.times, poses.times, (poses.positions + lever)[:, k]) for k in range(3)]
    np.testing.assert_allclose(survey.positions, np.column_stack(expected), atol=1e-12)
    R = Rotation.from_quat([0.0, 0.6, 0.0, 0.8])
    np.testing.assert_allclose(survey.orientations.as_matrix(), (body.orientations * R).as_matrix(), atol=1e-9)


def test_extrinsic_from_yaml(made, flight, saved, tmp_path):
    texts = [
        "translation: {x: 0.1, y: -0.2, z: 0.3}\nrotation: {x: 0, y: 0.6, z: 0, w: 0.8}\n",
        "transform:\n  translation: [0.1, -0.2, 0.3]\n  rotation: [0, 0.6, 0, 0.8]\n",
    ]
    expected = read_survey(saved(*flight.series), SurveyFormat(extrinsic="0.1,-0.2,0.3,0,0.6,0,0.8"))
    for text in texts:
        (tmp_path / "extrinsic.yaml").write_text(text)
        survey = read_survey(saved(*flight.series), SurveyFormat(extrinsic=str(tmp_path / "extrinsic.yaml")))
        np.testing.assert_array_equal(survey.positions, expected.positions)


def test_poses_from_tf_are_chained(made, flight, saved):
    """Sensor in map = (odom in map, slow) (base in odom, moving) (sensor in base, static)."""
    mag, odom = flight.series
    shift = np.tile([[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]], (8, 1))
    slow_ns = odom.log_ns[0] + np.arange(8) * SECOND
    tree = [
        made.Series("/tf", TF, slow_ns, shift, frame="map", child="odom"),
        made.Series("/tf", TF, odom.log_ns, odom.values, frame="odom", child="base_link"),
        static(made, flight, LEVER, "base_link", "mag_link"),
    ]
    path = saved(mag, *tree)
    survey = read_survey(path)
    assert survey.frame == "map"
    in_odom = read_survey(path, SurveyFormat(pose_frames="odom,base_link"))
    T = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_quat([0.0, 0.0, 0.6, 0.8]))
    np.testing.assert_allclose(survey.positions, T.apply(in_odom.positions), atol=1e-9)
    np.testing.assert_allclose(survey.field, T.rotation.apply(in_odom.field), atol=1e-18)


def test_field_in_the_frame_of_the_poses_is_not_turned(made, flight, saved):
    mag, odom = flight.series
    survey = read_survey(saved(made.replace(mag, frame="map"), odom))
    np.testing.assert_array_equal(survey.field, flight.mag)
    turned = read_survey(saved(made.replace(mag, frame="map"), odom), SurveyFormat(field_frame="sensor"))
    assert not np.allclose(turned.field, flight.mag)


def test_positions_without_orientations_serve_a_field_in_their_frame(made, flight, saved):
    mag, odom = flight.series
    points = made.replace(odom, type="geometry_msgs/msg/PointStamped", values=odom.values[:, :3])
    survey = read_survey(saved(made.replace(mag, frame="map"), points))
    assert survey.orientations is None
    np.testing.assert_array_equal(survey.field, flight.mag)
    with pytest.raises(DataFormatError, match="positions only"):
        read_survey(saved(mag, points))


def test_plain_vectors_are_a_field_when_named_and_offered_those_named_after_it_first(made, flight, saved):
    mag, odom = flight.series
    vectors = made.replace(mag, type="geometry_msgs/msg/Vector3Stamped", values=1e6 * mag.values)
    path = saved(vectors, odom)
    with pytest.raises(DataFormatError, match=r"expected a field topic.*: --mag-topic /imu/mag$"):
        read_survey(path)
    survey = read_survey(path, SurveyFormat(mag_topic="/imu/mag", field_unit="uT"))
    np.testing.assert_allclose(np.linalg.norm(survey.field, axis=1), np.linalg.norm(flight.mag, axis=1))
    vectors = [made.replace(mag, topic=name, type="geometry_msgs/msg/Vector3Stamped") for name in ("/acc", "/my_mag")]
    with pytest.raises(DataFormatError, match=r"--mag-topic /my_mag \(or /acc\)$"):
        read_survey(saved(*vectors, odom))
    with pytest.raises(
        DataFormatError, match=r"PointStamped\), found /my_mag [^;]*; poses .*--trajectory POSES.tum$"
    ):
        read_survey(saved(vectors[1]), SurveyFormat(mag_topic="/my_mag"))


def test_header_stamps_count_and_a_distant_log_clock_is_said(made, flight, saved, caplog):
    mag, odom = flight.series
    expected = read_survey(saved(mag, odom))
    late = [made.replace(s, log_ns=s.log_ns + 100 * SECOND, stamp_ns=s.stamp_ns) for s in (mag, odom)]
    survey = read_survey(saved(*late))
    np.testing.assert_array_equal(survey.times, expected.times)
    assert "was logged 100 s after its header stamps" in caplog.text
    assert "different clocks" not in caplog.text
    read_survey(saved(late[0], odom))
    assert "different clocks" in caplog.text


def test_stamps_that_share_no_time_give_way_to_log_times(made, flight, saved, caplog):
    mag, odom = flight.series
    booted = made.replace(odom, stamp_ns=odom.log_ns - odom.log_ns[0] + SECOND)
    survey = read_survey(saved(mag, booted))
    np.testing.assert_array_equal(survey.times, read_survey(saved(mag, odom)).times)
    assert "share no time: two clocks; log times are used" in caplog.text
    assert "Header stamps are used" not in caplog.text


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("step", [SECOND, 1000 * SECOND], ids=["whole seconds", "one for all"])
def test_stamps_that_were_cut_give_way_to_log_times(step, which, made, flight, saved, caplog):
    """Else all readings but the first of each second would be left out."""
    series = list(flight.series)
    series[which] = made.replace(series[which], stamp_ns=series[which].log_ns // step * step)
    survey = read_survey(saved(*series))
    np.testing.assert_array_equal(survey.times, read_survey(saved(*flight.series)).times)
    assert f"most messages of {series[which].topic} share their header stamps" in caplog.text


REPEATED = {
    "sent again until there is another": lambda k: (k // 4 * 4, k),
    "recorded twice": lambda k: (k // 3 * 3, k // 3 * 3),
}


@pytest.mark.parametrize("how", REPEATED)
def test_messages_that_repeat_stamp_and_numbers_were_not_cut(how, made, flight, saved, caplog):
    mag, odom = flight.series
    of, at = REPEATED[how](np.arange(len(odom.log_ns)))
    log_ns = odom.log_ns[at] + np.arange(len(at)) % 3
    again = made.replace(odom, log_ns=log_ns, stamp_ns=odom.stamp_ns[of], values=odom.values[of])
    survey = read_survey(saved(mag, again))
    first = made.replace(odom, log_ns=odom.log_ns[np.unique(of)], values=odom.values[np.unique(of)])
    first = made.replace(first, stamp_ns=odom.stamp_ns[np.unique(of)])
    np.testing.assert_array_equal(survey.positions, read_survey(saved(mag, first)).positions)
    assert "share their header stamps" not in caplog.text


def test_readings_that_came_in_bursts_keep_their_stamps(made, flight, saved, caplog):
    mag, odom = flight.series
    batch = np.arange(len(mag.log_ns)) // 5 * 5
    log_ns = mag.log_ns[batch] + np.arange(len(batch)) % 5 * 1000
    assert len(read_survey(saved(made.replace(mag, log_ns=log_ns, stamp_ns=mag.stamp_ns[batch]), odom))) == 60
    assert "240 messages of /imu/mag whose time another one has" in caplog.text


def test_an_axis_of_a_log_is_reversed_as_a_column_is(made, flight, saved):
    path = saved(*flight.series)
    as_read = read_survey(path, SurveyFormat(field_frame="survey")).field
    turned = read_survey(path, SurveyFormat(field_frame="survey", columns="bx=by,by=-bx")).field
    np.testing.assert_array_equal(turned, as_read[:, [1, 0, 2]] * [1, -1, 1])
    with pytest.raises(ConfigurationError, match="a log has none; expected ways of its axes such as by=-by, found"):
        read_survey(path, SurveyFormat(columns="bx=mag_x"))


def test_a_topic_without_orientations_is_not_said_to_be_recoverable(made, flight, saved):
    mag, odom = flight.series
    still = made.replace(odom, values=odom.values * [1, 1, 1, 0, 0, 0, 0])
    for recover in (False, True):
        with pytest.raises(DataFormatError, match=r"length 0; none of its \d+ messages is a whole nav_msgs"):
            read_survey(saved(mag, still), SurveyFormat(recover=recover))


@pytest.mark.parametrize("stamp", [0, -1])
def test_without_stamps_both_topics_take_log_times(made, flight, saved, caplog, stamp):
    mag, odom = flight.series
    zero = made.replace(mag, stamp_ns=np.full_like(mag.stamp_ns, stamp))
    survey = read_survey(saved(zero, made.replace(odom, stamp_ns=odom.log_ns + 50 * SECOND)))
    assert survey.times[0] == mag.log_ns[0] / SECOND
    assert "no stamps; log times are used" in caplog.text


def test_messages_out_of_order_are_sorted_and_repeats_dropped(made, flight, saved, caplog):
    mag, odom = flight.series
    order = np.arange(len(odom.log_ns))
    order[[40, 41]] = [41, 40]
    stamps = odom.stamp_ns[order]
    stamps[60] = stamps[59]
    survey = read_survey(saved(mag, made.replace(odom, stamp_ns=stamps, values=odom.values[order])))
    assert len(survey) == 300
    assert "1 messages of /odom came out of order" in caplog.text
    assert "1 messages of /odom whose time another one has" in caplog.text


@pytest.mark.parametrize("frames", ["map", "map,", ",base", "a,b,c", "map,map"])
def test_pose_frames_are_two_names(frames, made, flight, saved):
    tf = made.Series("/tf", TF, flight.pose_ns, flight.poses, frame="map", child="mag_link")
    with pytest.raises(ConfigurationError, match="--pose-frames"):
        read_survey(saved(flight.series[0], tf), SurveyFormat(pose_frames=frames))
