# SPDX-License-Identifier: BSD-3-Clause
"""From nodes to samples: between nodes the correction changes evenly along the path."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.slam.pose_graph import PoseGraph
from magmatch.slam.windows import Path


def corrected(path: Path, graph: PoseGraph) -> Survey:
    """A log's samples in the frame of its component: positions, field and orientations."""
    R, p, c = graph.R[path.nodes], graph.p[path.nodes], path.centers
    x, survey = path.survey.positions, path.survey
    at = path.walked[path.middles]
    one = np.clip(np.searchsorted(at, path.walked, side="right") - 1, 0, max(len(at) - 2, 0))
    other = np.minimum(one + 1, len(at) - 1)
    share = np.clip((path.walked - at[one]) / np.maximum(at[other] - at[one], 1e-9), 0.0, 1.0)
    a, b = (p[k] + np.einsum("nij,nj->ni", R[k], x - c[k]) for k in (one, other))
    between = Rotation.from_matrix(R[one]).inv() * Rotation.from_matrix(R[other])
    turned = Rotation.from_matrix(R[one]) * Rotation.from_rotvec(between.as_rotvec() * share[:, None])
    return replace(
        survey,
        positions=a + share[:, None] * (b - a),
        field=turned.apply(survey.field),
        orientations=None if survey.orientations is None else turned * survey.orientations,
    )
