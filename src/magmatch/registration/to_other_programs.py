# SPDX-License-Identifier: BSD-3-Clause
"""A registration for other programs: a TUM pose, a g2o edge with its information matrix, a ROS static transform."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import write_whole
from magmatch.data.tables.tum import write_tum
from magmatch.errors import SurveyError
from magmatch.geometry import covariance_about, near_origin
from magmatch.registration.g2o import Edge, RotationTangent, write_pose_graph
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Covariance6, Vector3


def accepted_transform(result: RegistrationResult) -> RigidTransform:
    """Give the transform, or raise the reason why there is none."""
    if result.T_base_target is None:
        msg = f"was not accepted ({result.status}), so there is no transform to write: {result.reason}"
        raise SurveyError(msg)
    return result.T_base_target


def write_relative_tum(result: RegistrationResult, path: str | Path) -> None:
    """Write ``T_base_target`` of an accepted result as one TUM row at time 0; raises SurveyError if refused."""
    T = accepted_transform(result)
    write_tum(path, np.zeros(1), T.translation[None], T.rotation.as_quat()[None], of="T_base_target: ")


def write_g2o(result: RegistrationResult, path: str | Path, tangent: RotationTangent = "quaternion") -> None:
    """Write base and target as vertices 0 and 1 and the registration as the edge between them.

    They are the frames of the surveys. Of those far from the samples they are points near the samples, with the
    frames' axes (`vertices_of`): about an origin at 5,000 km the information is singular in float64.

    Raises SurveyError unless it is accepted, with a covariance of full rank; ``tangent``: see `g2o_information`.
    """
    T = accepted_transform(result)
    base, target = vertices_of(result)
    C = None if result.covariance is None else covariance_about(result.covariance, target)
    if C is None or not _has_full_rank(C):
        msg = "the result has no covariance of full rank, which an edge of a pose graph needs"
        raise SurveyError(msg)
    T_base_near, T_target_near = RigidTransform.from_translation(base), RigidTransform.from_translation(target)
    Z = T_base_near.inv() * T * T_target_near
    write_pose_graph(path, [T_base_near, T * T_target_near], [Edge(0, 1, Z, C)], tangent)


def vertices_of(result: RegistrationResult) -> tuple[Vector3, Vector3]:
    """Place the vertices of an edge in base and target (m): at whole metres near the samples, or at the origin."""
    return near_origin(result.links.base, 1.0), near_origin(result.links.target, 1.0)


def _has_full_rank(C: Covariance6) -> bool:
    sd = np.sqrt(np.maximum(C.diagonal(), 0))
    return bool((sd > 0).all() and np.linalg.eigvalsh(C / np.outer(sd, sd))[0] > 0)


def write_static_transform(result: RegistrationResult, path: str | Path, base: str, target: str) -> None:
    """Write the transform of an accepted result as YAML of a ``geometry_msgs/TransformStamped``."""
    import yaml

    T = accepted_transform(result)
    content = {
        "header": {"frame_id": base},
        "child_frame_id": target,
        "transform": {
            "translation": dict(zip("xyz", T.translation.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", T.rotation.as_quat().tolist(), strict=True)),
        },
    }
    write_whole(path, yaml.safe_dump(content, sort_keys=False).encode())
