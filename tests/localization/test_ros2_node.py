# SPDX-License-Identifier: BSD-3-Clause
"""The example's pure part, on messages as rosbags makes them; rclpy itself is not needed."""

import importlib.util
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

pytest.importorskip("rosbags")

import magmatch as mm
from drifting import Place, drifting_walk, trajectory_error

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2_node.py"


@pytest.fixture(scope="module")
def node():
    spec = importlib.util.spec_from_file_location("ros2_node", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kinds():
    """Message classes by their names."""
    from rosbags.typesys import Stores, get_typestore

    return {name.rsplit("/", 1)[1]: kind for name, kind in get_typestore(Stores.ROS2_HUMBLE).types.items()}


def header(kinds, t, frame):
    stamp = kinds["Time"](sec=int(t), nanosec=round(1e9 * (t - int(t))))
    return kinds["Header"](stamp=stamp, frame_id=frame)


def odometry(kinds, t, T):
    p, q = T.translation, T.rotation.as_quat()
    place, turn = kinds["Point"](x=p[0], y=p[1], z=p[2]), kinds["Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3])
    pose = kinds["PoseWithCovariance"](pose=kinds["Pose"](position=place, orientation=turn), covariance=np.zeros(36))
    return kinds["Odometry"](header=header(kinds, t, "odom"), child_frame_id="base", pose=pose, twist=None)


def reading(kinds, t, b):
    vector = kinds["Vector3"](x=b[0], y=b[1], z=b[2])
    return kinds["MagneticField"](
        header=header(kinds, t, "base"), magnetic_field=vector, magnetic_field_covariance=np.zeros(9)
    )


def follow(follower, kinds, log):
    """Answers along a log whose readings come between poses."""
    field, found = log.orientations.inv().apply(log.field), []
    for n in range(len(log)):
        follower.fields.append(reading(kinds, log.times[n], field[n]))
        T = RigidTransform.from_components(log.positions[n], log.orientations[n])
        # The pose at a reading's time is between those of two messages.
        found.append((n, T, follower.take_odometry(odometry(kinds, log.times[n] + 1e-4, T))))
    return found


@pytest.fixture(scope="module")
def walked(node, kinds, place):
    """Answers along a walk, with what was true then."""
    log, truth = drifting_walk(Place(1), 2, laps=0.7, start=2.0, bias=(2e-6, -1e-6, 1e-6))
    follower = node.Follower(node.InMap(place.field_map), kinds)
    return follow(follower, kinds, log), truth, follower


@pytest.fixture(scope="module")
def mapped(node, kinds, tmp_path_factory):
    """The same of a walk of several laps that nothing was known of before, and the node's source after it."""
    log, truth = drifting_walk(Place(1), 2, laps=4.0, start=2.0, bias=(2e-6, -1e-6, 1e-6))
    source = node.Mapping(tmp_path_factory.mktemp("made") / "hall.map")
    return follow(node.Follower(source, kinds), kinds, log), log, truth, source


def places_of(made):
    """The pose's place, and where its transform takes odometry's pose."""
    pose, frame = made
    p, t, q = pose.pose.pose.position, frame.transform.translation, frame.transform.rotation
    T_map_odom = RigidTransform.from_components([t.x, t.y, t.z], Rotation.from_quat([q.x, q.y, q.z, q.w]))
    return np.array([p.x, p.y, p.z]), T_map_odom


def test_poses_are_where_the_body_was(walked):
    found, truth, _ = walked
    off = [np.linalg.norm(places_of(made)[0][:2] - truth[n, :2]) for n, _, made in found if made is not None]
    assert len(off) > 0.6 * len(found)
    assert np.median(off) < 0.15


@pytest.mark.parametrize("way", ["walked", "mapped"])
def test_the_transform_takes_odometry_to_the_pose(way, request):
    for _, T_odom_body, made in request.getfixturevalue(way)[0]:
        if made is None:
            continue
        pose, frame = made
        assert (frame.header.frame_id, frame.child_frame_id, pose.header.frame_id) == ("map", "odom", "map")
        assert frame.header.stamp == pose.header.stamp
        assert np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6)))[0] > 0
        # The message's pose is of the reading, a tenth of a millisecond before.
        p, T_map_odom = places_of(made)
        np.testing.assert_allclose((T_map_odom * T_odom_body).translation, p, atol=5e-3)


def test_the_covariance_is_ros_s(walked):
    now = walked[2].source.localizer.estimate()
    found = np.reshape(walked[0][-1][2][0].pose.covariance, (6, 6))
    R = now.T_map_body.rotation.as_matrix()
    np.testing.assert_allclose(found, found.T)
    np.testing.assert_allclose(found[:3, :3], R @ now.covariance[3:, 3:] @ R.T)
    np.testing.assert_allclose(found[3:, 3:], R @ now.covariance[:3, :3] @ R.T)


def test_drift_is_corrected_while_mapping(mapped):
    found, log, truth, _ = mapped
    stated = [n for n, _, made in found if made is not None]
    assert len(stated) > 0.5 * len(log)
    live = np.array([places_of(found[n][2])[0] for n in stated])
    half = len(stated) // 2  # of the laps that revisit
    before = trajectory_error(truth[stated][half:], log.positions[stated][half:])
    assert trajectory_error(truth[stated][half:], live[half:]) < 0.7 * before


@pytest.mark.slow
def test_the_map_of_the_walk_is_written_at_the_end(mapped, capsys):
    source = mapped[3]
    source.finish()
    assert "closure" in capsys.readouterr().out
    assert mm.FieldMap.load(source.path).knows(source.session.trajectories[0].positions).all()


def test_where_no_map_can_be_written_is_said_before_the_walk(node, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        node.Mapping(tmp_path / "file" / "hall.map")


@pytest.mark.parametrize("way", ["walked", "mapped"])
def test_no_old_pose_is_given_for_a_bad_reading(node, kinds, way, request):
    (*_, (_, T, made)), *_, last = request.getfixturevalue(way)
    assert made is not None
    follower, t = node.Follower(getattr(last, "source", last), kinds), 1e3
    follower.take_odometry(odometry(kinds, t - 0.1, T))
    for bad in ([np.nan, 0, 0], [20.0, 0, 40.0]):
        t, T = t + 0.1, T * RigidTransform.from_translation([0.1, 0, 0])
        follower.fields.append(reading(kinds, t, bad))
        assert follower.take_odometry(odometry(kinds, t + 0.01, T)) is None


def test_odometry_that_begins_anew_between_two_messages_moves_nobody(node, kinds, place):
    """Ten readings come between two poses: none of them lies on a way between the old frame and the new one."""
    log, _ = drifting_walk(Place(1), 2, laps=0.7, start=2.0)
    seen = []
    source = SimpleNamespace(follow=lambda t, T, field: (seen.append(T.translation), (None, None))[1])
    follower = node.Follower(source, kinds)
    R = log.orientations
    for n, shift in ((0, 0.0), (10, 0.0), (20, 30.0)):
        for k in range(10):
            follower.fields.append(reading(kinds, log.times[n] - 0.01 * k, log.field[n]))
        follower.fields = deque(sorted(follower.fields, key=node.seconds))
        T = RigidTransform.from_components(log.positions[n] + [shift, 0, 0], R[n])
        follower.take_odometry(odometry(kinds, log.times[n] + 1e-4, T))
    x = np.array(seen)[:, 0]
    assert not ((x > 10) & (x < 20)).any()
    assert (x > 20).any()
