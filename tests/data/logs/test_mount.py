# SPDX-License-Identifier: BSD-3-Clause
"""Where the sensor sits is looked for wherever a log may say it, before nothing is said to say so."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey

TF, STRING = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
MAST, LINK = np.array([[0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8], [0.0, 0.05, 0.1, 0.48, 0.0, 0.6, 0.64]])
WHOLE = RigidTransform.from_components(MAST[:3], Rotation.from_quat(MAST[3:])) * RigidTransform.from_components(
    LINK[:3], Rotation.from_quat(LINK[3:])
)
WHOLE_VALUES = np.array([*WHOLE.translation, *WHOLE.rotation.as_quat()])
EXTRINSIC = " ".join(map(repr, [*WHOLE.translation.tolist(), *WHOLE.rotation.as_quat().tolist()]))


@pytest.fixture
def said(made, flight, tmp_path):
    """A log that says how `base` moves, and what else is given; and what it gives where the mount is stated."""
    mag, odom = flight.series
    log = [mag, made.replace(odom, child="base")]

    def read(*others, **settings):
        return read_survey(made.mcap(tmp_path / "log.mcap", [*log, *others]), SurveyFormat(**settings))

    return read


@pytest.fixture
def edge(made, flight):
    """An edge of tf that says the same each time, but for what is added."""

    def make(values, frame, child, topic="/tf", n=60, added=0.0):
        return made.Series(topic, TF, flight.pose_ns[:n], np.tile(values, (n, 1)) + added, frame=frame, child=child)

    return make


def close(survey, expected, atol=1e-12):
    np.testing.assert_allclose(survey.positions, expected.positions, rtol=0, atol=atol)  # m
    np.testing.assert_allclose(survey.field, expected.field, rtol=0, atol=5e-5 * atol)  # T


@pytest.mark.parametrize(
    "topics",
    [("/tf", "/tf"), ("/tf_static", "/tf"), ("/tf", "/tf_static"), ("/r1/tf", "/r1/tf_static"), 2 * ("/tf_static",)],
)
def test_a_mount_may_be_on_tf_and_tf_static_in_turns(topics, said, edge, caplog):
    expected = said(extrinsic=EXTRINSIC)
    close(said(edge(MAST, "base", "mast", topics[0]), edge(LINK, "mast", "mag_link", topics[1])), expected)
    assert "nothing says" not in caplog.text


def test_signs_of_quaternions_and_single_precision_make_no_motion(said, edge):
    expected = said(extrinsic=EXTRINSIC)
    signs = np.where(np.arange(60)[:, None] % 2, [1, 1, 1, -1, -1, -1, -1], np.ones(7))
    flipped = edge(MAST, "base", "mast")
    flipped.values = (signs * flipped.values).astype(np.float32).astype(float)
    close(said(flipped, edge(LINK, "mast", "mag_link")), expected, atol=1e-6)


def test_a_mount_is_found_beside_edges_that_move(said, edge):
    expected = said(extrinsic=EXTRINSIC)
    arm = edge(MAST, "base", "arm", added=0.01 * np.arange(60)[:, None] * np.eye(7)[0])
    close(said(arm, edge(MAST, "base", "mast"), edge(LINK, "mast", "mag_link")), expected)


def test_beside_a_trajectory_of_another_file_the_mount_is_said_not_to_be_used(made, flight, edge, tmp_path, caplog):
    """Nobody knows which frame of the log it is of."""
    flight.trajectory().save(tmp_path / "poses.tum")
    path = made.mcap(tmp_path / "log.mcap", [*flight.series, edge(WHOLE_VALUES, "base", "mag_link", "/tf_static")])
    read_survey(path, SurveyFormat(trajectory=tmp_path / "poses.tum"))
    words = (
        "nothing says where 'mag_link' sits on the body whose poses these are; the poses are taken as the magnetom"
    )
    assert words in caplog.text
    caplog.clear()
    read_survey(path, SurveyFormat(trajectory=tmp_path / "poses.tum", extrinsic="0 0 0"))
    assert "nothing says" not in caplog.text


def test_a_sensor_without_a_frame_is_said_to_be_without_a_mount(made, flight, edge, tmp_path, caplog):
    mag, odom = flight.series
    mast = edge(MAST, "base", "mag_link", "/tf_static")
    path = tmp_path / "log.mcap"
    survey = read_survey(made.mcap(path, [made.replace(mag, frame=""), made.replace(odom, child="base"), mast]))
    words = (
        "nothing says where the sensor (its messages name no frame) sits on 'base'; the poses are taken as the mag"
    )
    assert words in caplog.text
    close(survey, read_survey(made.mcap(path, [mag, odom])))
    caplog.clear()
    read_survey(made.mcap(path, [made.replace(mag, frame=""), made.replace(odom, child="")]))
    assert "nothing says" not in caplog.text


def test_an_edge_that_moves_is_no_mount_and_said_to_move(said, edge, caplog):
    moving = edge(MAST, "base", "mast", added=2e-6 * np.arange(60)[:, None] * np.eye(7)[0])
    survey = said(moving, edge(LINK, "mast", "mag_link"))
    assert (
        "tf moves 'mag_link' against 'base'; the poses are taken as the magnetometer's own (--extrinsic)"
        in caplog.text
    )
    assert "nothing says" not in caplog.text
    close(survey, said())


def test_where_tf_holds_the_sensors_poses_the_way_to_them_is_named(made, flight, said, edge, caplog):
    arm = edge(MAST, "base", "mag_link", added=1e-3 * np.arange(60)[:, None] * np.eye(7)[0])
    odom = made.replace(flight.series[1], topic="/tf", type=TF, child="base")
    said(arm, odom)
    assert "(--pose-frames map,mag_link takes them from tf)" in caplog.text
    said(arm, odom, pose_frames="map,mag_link")


URDF = """<robot name="r"><link name="base"/><link name="mast"/>
<joint name="a" type="fixed"><parent link="base"/><child link="mast"/><origin xyz="0.1 -0.2 0.3" rpy="{}"/></joint>
<joint name="b" type="{}"><parent link="/mast"/><child link="mag_link"/></joint></robot>"""
RPY = " ".join(map(repr, Rotation.from_quat(MAST[3:]).as_euler("xyz").tolist()))


def test_a_mount_may_be_a_fixed_joint_of_the_robots_description(made, flight, said, caplog):
    expected = said(extrinsic=" ".join(map(repr, MAST.tolist())))
    for topic in ("/robot_description", "/r1/robot_description"):
        text = made.Series(topic, STRING, flight.pose_ns[:1], [URDF.format(RPY, "fixed")])
        close(said(text), expected)
    assert "nothing says" not in caplog.text


@pytest.mark.parametrize(
    "text", [URDF.format(RPY, "revolute"), URDF.format("0 0", "fixed"), "<robot", "", "<!ENTITY"]
)
def test_a_description_that_does_not_say_it_is_none(text, made, flight, said, caplog):
    said(made.Series("/robot_description", STRING, flight.pose_ns[:1], [text]))
    assert "nothing says where 'mag_link' sits on 'base'" in caplog.text


def test_damage_of_tf_is_no_reason_to_refuse_what_has_its_own_poses(said, edge, caplog):
    said(edge(np.full(7, np.nan), "base", "mag_link"))
    assert "nothing says where 'mag_link' sits on 'base'" in caplog.text


@pytest.mark.parametrize("slash", ["", "/"])
def test_a_topic_is_found_with_and_without_its_slash(slash, made, flight, tmp_path):
    mag, odom = flight.series
    path = made.mcap(
        tmp_path / "log.mcap", [made.replace(mag, topic=slash + "mag"), made.replace(odom, topic=slash + "p")]
    )
    for asked in ("", "/"):
        assert len(read_survey(path, SurveyFormat(mag_topic=asked + "mag", pose_topic=asked + "p"))) == 300


def test_a_mount_is_told_from_motion_where_few_messages_are_held(said, edge, caplog, monkeypatch):
    """Few messages of each edge are held; a move between two of them, and back, is seen all the same."""
    monkeypatch.setattr("magmatch.data.logs.messages.THINNED", 16)
    expected = said(extrinsic=" ".join(map(repr, MAST.tolist())))
    close(said(edge(MAST, "base", "mag_link")), expected)
    once = np.zeros((60, 1)) + 1e-3 * (np.arange(60) == 37)[:, None] * np.eye(7)[1]
    said(edge(MAST, "base", "mag_link", added=once))
    assert "tf moves 'mag_link' against 'base'" in caplog.text
