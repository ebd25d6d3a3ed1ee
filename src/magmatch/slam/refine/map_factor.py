# SPDX-License-Identifier: BSD-3-Clause
"""A window's pose on the map of several passes, as a factor with all of them."""

import numpy as np
from scipy.special import expit, logit

from magmatch.geometry import product, rotation_matrix
from magmatch.slam.decide.answer import off_level
from magmatch.slam.graph.factors import MapFactor
from magmatch.slam.graph.odometry import covariance_beside
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.refine.known_path import Beside
from magmatch.slam.search.loop_closure import Match
from magmatch.slam.search.predicted import SURE
from magmatch.slam.windows import Path, Window


def map_factor(window: Window, match: Match, beside: Beside, graph: PoseGraph, path: Path) -> MapFactor | None:
    """The factor of a pose that was found; none if it is less probable than a closure must be.

    The graph knows that the window lies there, as it does for closures near a place that is known.
    """
    probability = float(expit(match.log_odds + logit(SURE)))
    if probability < graph.config.min_probability:
        return None
    T_map_node = product(match.T_base_log, window.T_log_node, match.T_node_alone)
    T_passes_node = [product(graph.pose(node).inv(), T_map_node) for node in beside.passes.tolist()]
    covariance = match.covariance_alone + off_level(graph.config)
    for node, share, T in zip(beside.passes.tolist(), beside.shares, T_passes_node, strict=True):
        covariance = covariance + share**2 * covariance_beside(path, node, T, graph.config)
    R, t = np.stack([rotation_matrix(T) for T in T_passes_node]), np.stack([T.translation for T in T_passes_node])
    return MapFactor(window.node, beside.passes, beside.shares, R, t, covariance, probability)
