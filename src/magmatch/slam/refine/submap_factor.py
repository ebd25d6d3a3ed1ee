# SPDX-License-Identifier: BSD-3-Clause
"""A window's pose on its submap as a factor with all passes of that."""

import numpy as np
from scipy.special import expit, logit

from magmatch.geometry import product, rotation_matrix
from magmatch.slam.decide.answer import off_level
from magmatch.slam.graph.factors import LEAST_KEPT, SubmapFactor
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.refine.submap import JointSubmap
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.search.predicted import SURE
from magmatch.slam.windows import Path


def submap_factor(
    found: Candidate, node: int, submap: JointSubmap, graph: PoseGraph, path: Path
) -> SubmapFactor | None:
    """The factor of a pose that was found for a node's window; none if it is no more probable than not.

    The graph knows that the window lies there, as it does for closures near a place that is known.
    """
    probability = float(expit(found.match.log_odds + logit(SURE)))
    if probability <= LEAST_KEPT:
        return None
    T_map_node = product(graph.pose(submap.best_known), found.T_node_window, found.match.T_node_alone)
    T_passes_node = [product(graph.pose(one).inv(), T_map_node) for one in submap.passes.tolist()]
    covariance = found.match.covariance_alone + off_level(graph.config)
    for one, share, T in zip(submap.passes.tolist(), submap.shares, T_passes_node, strict=True):
        covariance = covariance + share**2 * covariance_beside(path, one, T, graph.config)
    R, t = np.stack([rotation_matrix(T) for T in T_passes_node]), np.stack([T.translation for T in T_passes_node])
    return SubmapFactor(node, submap.passes, submap.shares, R, t, covariance, probability)
