# SPDX-License-Identifier: BSD-3-Clause
"""From nodes to samples: between nodes the correction is interpolated along the path."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.windows import Path
from magmatch.typing import Indices, Points, Scalars


def corrected(path: Path, graph: PoseGraph) -> Survey:
    """A log's samples in the frame of its component: positions, field and orientations."""
    survey = path.survey
    positions, turned = moved(path, graph, path.walked, survey.positions), _turned(path, graph, path.walked)
    return replace(
        survey,
        positions=positions,
        field=turned.apply(survey.field),
        orientations=None if survey.orientations is None else turned * survey.orientations,
    )


def corrected_poses(path: Path, graph: PoseGraph, poses: Trajectory | None) -> Trajectory | None:
    """A log's poses in that frame: at their own times where given, else its samples'; None where it has none."""
    survey = path.survey
    if survey.times is None:
        return None
    if poses is None:
        if survey.orientations is None or len(survey) < 2:
            return None
        poses = Trajectory(survey.times, survey.positions, survey.orientations)
    walked = np.interp(poses.times, survey.times, path.walked)
    turned = _turned(path, graph, walked)
    return Trajectory(poses.times, moved(path, graph, walked, poses.positions), turned * poses.orientations)


def moved(path: Path, graph: PoseGraph, walked: Scalars, x: Points) -> Points:
    """Points of the odometry's frame after so much of the path, in the component's frame."""
    R, p, c = graph.R[path.nodes], graph.p[path.nodes], path.centers
    one, other, share = around(path, walked)
    a, b = (p[k] + np.einsum("nij,nj->ni", R[k], x - c[k]) for k in (one, other))
    return np.asarray(a + share[:, None] * (b - a))


def _turned(path: Path, graph: PoseGraph, walked: Scalars) -> Rotation:
    """Rotation of odometry's axes after so much of the path."""
    R = graph.R[path.nodes]
    one, other, share = around(path, walked)
    between = Rotation.from_matrix(R[one]).inv() * Rotation.from_matrix(R[other])
    return Rotation.from_matrix(R[one]) * Rotation.from_rotvec(between.as_rotvec() * share[:, None])


def around(path: Path, walked: Scalars) -> tuple[Indices, Indices, Scalars]:
    """Windows whose nodes lie before and after so much of the path, and which share of the way between is behind."""
    at = path.walked[path.middles]
    one = np.clip(np.searchsorted(at, walked, side="right") - 1, 0, max(len(at) - 2, 0))
    other = np.minimum(one + 1, len(at) - 1)
    return one, other, np.clip((walked - at[one]) / np.maximum(at[other] - at[one], 1e-9), 0.0, 1.0)
