# SPDX-License-Identifier: BSD-3-Clause
"""Foxglove's protocol shows the same picture, on this machine only: transforms, ellipses, hypotheses and the maps."""

import time
from importlib import import_module
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.errors import ConfigurationError, import_extra

# Standard deviations that an ellipse spans: 95 % of a plane's Gaussian.
SIGMAS = 2.45
UNSURE = {"r": 0.34, "g": 0.38, "b": 0.42, "a": 0.6}


class FoxgloveFeed:
    """A Foxglove server beside the service's own."""

    def __init__(self, port: int) -> None:
        foxglove = import_extra("foxglove", "Foxglove's protocol", "foxglove", "./packages/magmatch-serve")
        channels, self._messages = import_module("foxglove.channels"), import_module("foxglove.messages")
        context = self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name="magmatch", host="127.0.0.1", port=port, context=context)
        except RuntimeError as error:
            msg = f"--foxglove {port}: {error}; say another port"
            raise ConfigurationError(msg) from None
        self._frames = channels.FrameTransformsChannel("/tf", context=context)
        self._scene = channels.SceneUpdateChannel("/bodies", context=context)
        self._maps = channels.GridChannel("/maps", context=context)

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._server.port)

    def show(self, bodies: list[dict[str, Any]]) -> None:
        """Send the bodies whose pose is stated, and the hypotheses for the others."""
        m, now = self._messages, time.time()
        stamp = m.Timestamp.from_epoch_secs(now)
        frames, entities = [], []
        for body in bodies:
            if "T_map_body" not in body:
                found = enumerate(body.get("hypotheses", []))
                entities += [self._hypothesis(stamp, f"{body['client']} {k}", *one) for k, one in found]
                continue
            T = np.array(body["T_map_body"])
            q = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
            p = m.Vector3(x=T[0, 3], y=T[1, 3], z=T[2, 3])
            # A frame has one place, and nothing keeps clients from one name.
            parent, child = body["map"] or "map", f"{body['name']} {body['client']}".strip()
            turn = m.Quaternion(x=q[0], y=q[1], z=q[2], w=q[3])
            frames.append(
                m.FrameTransform(
                    timestamp=stamp, parent_frame_id=parent, child_frame_id=child, translation=p, rotation=turn
                )
            )
            entities.append(self._ellipse(stamp, parent, body, T))
        if frames:
            self._frames.log(m.FrameTransforms(transforms=frames))
        if entities:
            self._scene.log(m.SceneUpdate(entities=entities))

    def show_map(self, frame: str, picture: dict[str, Any]) -> None:
        """Send a map from above (`picture_of`), in the frame of the bodies in it."""
        m, (n_rows, n_columns) = self._messages, picture["shape"]
        (x0, x1), (y0, y1) = picture["x"], picture["y"]
        dx, dy = (x1 - x0) / max(n_columns - 1, 1), (y1 - y0) / max(n_rows - 1, 1)
        corner = m.Vector3(x=x0 - dx / 2, y=y0 - dy / 2, z=picture["height"])
        # None, where the field is not known, is NaN.
        field = np.array(picture["field_ut"], dtype="<f4")
        element = m.PackedElementField(name="field_ut", offset=0, type=m.PackedElementFieldNumericType.Float32)
        self._maps.log(
            m.Grid(
                timestamp=m.Timestamp.from_epoch_secs(time.time()), frame_id=frame,
                pose=m.Pose(position=corner, orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)),
                column_count=n_columns, cell_size=m.Vector2(x=dx, y=dy), row_stride=4 * n_columns, cell_stride=4,
                fields=[element], data=field.tobytes(),
            )
        )  # fmt: skip

    def _hypothesis(self, stamp: Any, name: str, frame: str, x: float, y: float, z: float, odds: float) -> Any:
        m, size = self._messages, 0.2 + 0.6 * float(np.sqrt(odds))
        pose = m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
        ball = m.SpherePrimitive(pose=pose, size=m.Vector3(x=size, y=size, z=size), color=m.Color(**UNSURE))
        life = m.Duration(sec=2)
        return m.SceneEntity(timestamp=stamp, frame_id=frame or "map", id=name, lifetime=life, spheres=[ball])

    def _ellipse(self, stamp: Any, frame: str, body: dict[str, Any], T: np.ndarray) -> Any:
        m = self._messages
        variances, axes = np.linalg.eigh(np.array(body["covariance_xy"]))
        x, y = (2 * SIGMAS * np.sqrt(np.maximum(variances, 1e-12))).tolist()
        q = Rotation.from_euler("z", np.arctan2(axes[1, 0], axes[0, 0])).as_quat().tolist()
        pose = m.Pose(
            position=m.Vector3(x=T[0, 3], y=T[1, 3], z=T[2, 3]),
            orientation=m.Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]),
        )
        is_in = body["status"] == "localized"
        color = m.Color(r=0.0, g=0.48, b=0.35, a=0.6) if is_in else m.Color(r=0.83, g=0.37, b=0.0, a=0.6)
        disc = m.CylinderPrimitive(
            pose=pose, size=m.Vector3(x=x, y=y, z=0.02), bottom_scale=1.0, top_scale=1.0, color=color
        )
        life = m.Duration(sec=2)
        return m.SceneEntity(timestamp=stamp, frame_id=frame, id=body["client"], lifetime=life, cylinders=[disc])

    def stop(self) -> None:
        """End the server."""
        self._server.stop()
