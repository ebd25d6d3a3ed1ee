# SPDX-License-Identifier: BSD-3-Clause
"""MagneticField and Odometry in; PoseWithCovarianceStamped and map -> odom out. Ctrl-C ends it.

python ros2_node.py MAP         localises in a map; silent until it is sure of the place
python ros2_node.py --make MAP  maps, corrects drift where it passes a place again, writes MAP at the end
Frames: map is that of MAP, or begins as odom; odom and body are the Odometry's. The field (T) must be in body axes.
"""

import sys
from collections import deque
from contextlib import suppress
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm

seconds = lambda message: message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec  # noqa: E731


class InMap:
    """Pose and covariance (rotation first, body axes) from a localizer in a known map; None where it is not sure."""

    def __init__(self, place):
        self.localizer = mm.Localizer(place)

    def follow(self, t, T_odom_body, field):
        self.localizer.update(t, T_odom_body, field)
        return (now := self.localizer.estimate()).T_map_body, now.covariance


class Mapping:
    """The same from a session that maps: against where it began, None until its first windows are complete."""

    def __init__(self, path, config=None):
        self.path, self.session, self.covariance = Path(path), mm.Session(config), None
        self.path.absolute().parent.mkdir(parents=True, exist_ok=True)  # refused now, not after the walk

    def follow(self, t, T_odom_body, field):
        if self.session.add(t, T_odom_body, field):  # a window is complete, all poses may have changed
            place, turn = self.session.result().logs[-1].sd  # m and rad, root of the sum of three variances
            self.covariance = np.diag(np.repeat([turn**2, place**2], 3) / 3)
        return None if self.covariance is None else self.session.pose(), self.covariance

    def finish(self):
        """Correct the whole walk once more, now that all of it is known, and write its map."""
        self.session.finish("walk")
        self.session.map().save(self.path)
        print(self.session.result().reason)


class Follower:
    """The node without ROS: messages in, messages out. `kinds` holds their classes by name."""

    def __init__(self, source, kinds):
        self.source, self.kinds, self.last, self.fields = source, kinds, None, deque(maxlen=500)

    def take_odometry(self, message):
        """Pose and transform at the last of the readings that odometry has passed; None where they are not sure."""
        p, q = message.pose.pose.position, message.pose.pose.orientation
        T1 = RigidTransform.from_components([p.x, p.y, p.z], Rotation.from_quat([q.x, q.y, q.z, q.w]))
        (t0, T0), t1, made = self.last or (seconds(message), T1), seconds(message), None
        T0 = T1 if np.linalg.norm(T0.translation - T1.translation) > 5 else T0  # odometry began anew: no motion
        self.last = t1, T1
        while self.fields and seconds(self.fields[0]) <= t1:
            field = self.fields.popleft()
            if t0 <= (t := seconds(field)) and t0 < t1:
                step = (T0.inv() * T1).as_exp_coords() * (t - t0) / (t1 - t0)
                made = self._follow(field, t, T0 * RigidTransform.from_exp_coords(step), message.header.frame_id)
        return made

    def _follow(self, field, t, T_odom_body, odom_frame):
        b, T_map_body, C = field.magnetic_field, None, None
        with suppress(ValueError):  # NaN, a clock that runs backward, a jump: the next one may be good
            T_map_body, C = self.source.follow(t, T_odom_body, np.array([b.x, b.y, b.z]))
        if T_map_body is None:
            return None
        new, header = self.kinds, self.kinds["Header"](stamp=field.header.stamp, frame_id="map")
        A = np.kron([[0, 1], [1, 0]], T_map_body.rotation.as_matrix())  # ROS: translation first, map's axes
        p, q = self._parts("Point", T_map_body)
        pose = new["Pose"](position=p, orientation=q)
        pose = new["PoseWithCovariance"](pose=pose, covariance=(A @ C @ A.T).ravel())
        p, q = self._parts("Vector3", T_map_body * T_odom_body.inv())
        T = new["Transform"](translation=p, rotation=q)
        frame = new["TransformStamped"](header=header, child_frame_id=odom_frame, transform=T)
        return new["PoseWithCovarianceStamped"](header=header, pose=pose), frame

    def _parts(self, kind, T):
        p, q = T.translation.tolist(), T.rotation.as_quat().tolist()
        return self.kinds[kind](x=p[0], y=p[1], z=p[2]), self.kinds["Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3])


def main():
    import rclpy.executors, tf2_ros  # noqa: E401, I001
    from geometry_msgs import msg as geometry
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import MagneticField
    from std_msgs.msg import Header

    *make, path = sys.argv[1:]
    rclpy.init()
    node, source = rclpy.create_node("magmatch"), Mapping(path) if make else InMap(mm.FieldMap.load(path))
    frames, follower = tf2_ros.TransformBroadcaster(node), Follower(source, vars(geometry) | {"Header": Header})
    poses = node.create_publisher(geometry.PoseWithCovarianceStamped, "pose", 10)

    def follow(message):
        if made := follower.take_odometry(message):
            poses.publish(made[0])
            frames.sendTransform(made[1])

    node.create_subscription(MagneticField, "imu/mag", follower.fields.append, 100)
    node.create_subscription(Odometry, "odom", follow, 100)
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)
    return source.finish() if make else None


if __name__ == "__main__":
    main()
