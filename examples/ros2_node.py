# SPDX-License-Identifier: BSD-3-Clause
"""MagneticField and Odometry in; PoseWithCovarianceStamped and map -> odom out. Run: python ros2_node.py MAP."""

import sys
from collections import deque
from contextlib import suppress

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm

seconds = lambda message: message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec  # noqa: E731


class Follower:
    """The node without ROS: messages in, messages out. `kinds` holds their classes by name."""

    def __init__(self, place, kinds):
        self.localizer, self.kinds, self.last, self.fields = mm.Localizer(place), kinds, None, deque(maxlen=500)

    def take_odometry(self, message):
        """Pose and transform at the last of the readings that odometry has passed; None where they are not sure."""
        p, q = message.pose.pose.position, message.pose.pose.orientation
        R = Rotation.from_quat([q.x, q.y, q.z, q.w])
        now = seconds(message), RigidTransform.from_components([p.x, p.y, p.z], R)
        (t0, T0), self.last, made = self.last or now, now, None
        while self.fields and seconds(self.fields[0]) <= now[0]:
            field = self.fields.popleft()
            if t0 <= (t := seconds(field)) and t0 < now[0]:
                step = (T0.inv() * now[1]).as_exp_coords() * (t - t0) / (now[0] - t0)
                made = self._follow(field, t, T0 * RigidTransform.from_exp_coords(step), message.header.frame_id)
        return made

    def _follow(self, field, t, T_odom_body, odom_frame):
        b = field.magnetic_field
        with suppress(ValueError):  # NaN, a clock that runs backward, a jump: the next one may be good
            self.localizer.update(t, T_odom_body, np.array([b.x, b.y, b.z]))
        now = self.localizer.estimate()
        if not now.is_stated:
            return None
        new, header = self.kinds, self.kinds["Header"](stamp=field.header.stamp, frame_id="map")
        A = np.kron([[0, 1], [1, 0]], now.T_map_body.rotation.as_matrix())  # ROS: translation first, map's axes
        p, q = self._parts("Point", now.T_map_body)
        pose, C = new["Pose"](position=p, orientation=q), (A @ now.covariance @ A.T).ravel()
        p, q = self._parts("Vector3", now.T_map_body * T_odom_body.inv())
        T = new["Transform"](translation=p, rotation=q)
        frame = new["TransformStamped"](header=header, child_frame_id=odom_frame, transform=T)
        pose = new["PoseWithCovariance"](pose=pose, covariance=C)
        return new["PoseWithCovarianceStamped"](header=header, pose=pose), frame

    def _parts(self, kind, T):
        p, q = T.translation.tolist(), T.rotation.as_quat().tolist()
        return self.kinds[kind](x=p[0], y=p[1], z=p[2]), self.kinds["Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3])


def main():
    import rclpy, tf2_ros  # noqa: E401, I001
    from geometry_msgs import msg as geometry
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import MagneticField
    from std_msgs.msg import Header

    rclpy.init()
    node, kinds = rclpy.create_node("magmatch"), vars(geometry) | {"Header": Header}
    follower, frames = Follower(mm.FieldMap.load(sys.argv[1]), kinds), tf2_ros.TransformBroadcaster(node)
    poses = node.create_publisher(geometry.PoseWithCovarianceStamped, "pose", 10)

    def follow(message):
        if made := follower.take_odometry(message):
            poses.publish(made[0])
            frames.sendTransform(made[1])

    node.create_subscription(MagneticField, "imu/mag", follower.fields.append, 100)
    node.create_subscription(Odometry, "odom", follow, 100)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
