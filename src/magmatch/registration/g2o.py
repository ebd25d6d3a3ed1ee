# SPDX-License-Identifier: BSD-3-Clause
"""Files of g2o, which GTSAM and Ceres read too: poses, and measured relative poses with their information."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import write_whole
from magmatch.number_text import exact
from magmatch.typing import Covariance6

RotationTangent = Literal["quaternion", "angle"]


class Edge(NamedTuple):
    """A measured pose of one vertex in the axes of another, both by number."""

    first: int
    second: int
    T_first_second: RigidTransform
    covariance: Covariance6  # (6, 6): of xi in ``T Exp(xi)``, rotation first


def write_pose_graph(
    path: str | Path,
    vertices: Iterable[RigidTransform],
    edges: Iterable[Edge],
    tangent: RotationTangent = "quaternion",
) -> None:
    """Write poses, numbered from 0, and the edges between them; ``tangent``: see `g2o_information`."""
    # No comment: Ceres' reader takes none.
    lines = [f"VERTEX_SE3:QUAT {k} {_pose(T)}" for k, T in enumerate(vertices)]
    for first, second, T, covariance in edges:
        information = exact(g2o_information(covariance, tangent)[np.triu_indices(6)])
        lines.append(f"EDGE_SE3:QUAT {first} {second} {_pose(T)} {' '.join(information)}")
    write_whole(path, "\n".join([*lines, ""]).encode())


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


def _pose(T: RigidTransform) -> str:
    return " ".join(exact([*T.translation, *T.rotation.as_quat()]))
