# SPDX-License-Identifier: BSD-3-Clause
"""A registration for other programs: a TUM pose, a g2o edge with its information matrix, a ROS static transform."""

from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import atomic_write
from magmatch.data.points import spaced
from magmatch.errors import SurveyError
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Covariance6

RotationTangent = Literal["quaternion", "angle"]


def accepted_transform(result: RegistrationResult) -> RigidTransform:
    """Give the transform, or raise the reason why there is none."""
    if result.T_base_target is None:
        msg = f"was not accepted ({result.status}), so there is no transform to write: {result.reason}"
        raise SurveyError(msg)
    return result.T_base_target


def write_relative_tum(result: RegistrationResult, path: str | Path) -> None:
    """Write ``T_base_target`` of an accepted result as one TUM row at time 0; raises SurveyError if refused."""
    T = accepted_transform(result)
    numbers = [0.0, *T.translation.tolist(), *T.rotation.as_quat().tolist()]
    text = "# T_base_target: t x y z qx qy qz qw\n" + " ".join(map(repr, numbers)) + "\n"
    with atomic_write(path) as stream:
        stream.write(text.encode())


def g2o_information(covariance: Covariance6, tangent: RotationTangent = "quaternion") -> np.ndarray:
    """Information matrix of a g2o edge.

    To first order ``Exp(xi)`` has translation ``rho`` and quaternion ``(theta / 2, 1)``, so that the error of g2o is
    ``e = (rho, theta / 2)`` and its information ``(J S J^T)^-1`` with ``J = [[0, I], [I / 2, 0]]``.
    """
    J = np.zeros((6, 6))
    J[:3, 3:] = np.eye(3)
    J[3:, :3] = np.eye(3) * (0.5 if tangent == "quaternion" else 1.0)
    moved = J @ covariance @ J.T
    # Scaled to correlations first: rad and m differ by orders of magnitude.
    scale = np.sqrt(np.diagonal(moved))
    inverse = np.linalg.inv(moved / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


def g2o_vertex(node: int, T: RigidTransform) -> str:
    """A pose as a line of g2o."""
    return f"VERTEX_SE3:QUAT {node} {_pose(T)}"


def g2o_edge(
    first: int, second: int, T: RigidTransform, covariance: Covariance6, tangent: RotationTangent = "quaternion"
) -> str:
    """A measured relative pose as a line of g2o; covariance of xi in ``T Exp(xi)``, rotation first."""
    information = g2o_information(covariance, tangent)
    return f"EDGE_SE3:QUAT {first} {second} {_pose(T)} {spaced(information[np.triu_indices(6)].tolist())}"


def write_g2o(result: RegistrationResult, path: str | Path, tangent: RotationTangent = "quaternion") -> None:
    """Write base and target as vertices 0 and 1 and the registration as the edge between them.

    Raises SurveyError unless it is accepted, with a covariance of full rank; ``tangent``: see `g2o_information`.
    """
    T = accepted_transform(result)
    if result.covariance is None or np.linalg.eigvalsh(result.covariance)[0] <= 0:
        msg = "the result has no covariance of full rank, which an edge of a pose graph needs"
        raise SurveyError(msg)
    lines = [
        f"# magmatch: T_base_target; information of (translation, rotation as {tangent}) of Z^-1 T_true",
        g2o_vertex(0, RigidTransform.identity()),
        g2o_vertex(1, T),
        g2o_edge(0, 1, T, result.covariance, tangent),
        "",
    ]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines).encode())


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
    with atomic_write(path) as stream:
        stream.write(yaml.safe_dump(content, sort_keys=False).encode())


def _pose(T: RigidTransform) -> str:
    return spaced([*T.translation.tolist(), *T.rotation.as_quat().tolist()])
