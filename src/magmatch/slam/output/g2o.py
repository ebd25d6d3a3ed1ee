# SPDX-License-Identifier: BSD-3-Clause
"""The graph for other programs: g2o's vertices, and its edges with their information matrices."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import atomic_write
from magmatch.registration.to_other_programs import g2o_edge, g2o_vertex
from magmatch.slam.graph.factors import FixedPoints
from magmatch.slam.graph.normal_equations import shared
from magmatch.slam.graph.pose_graph import FREE, SURE, PoseGraph


def write_graph(graph: PoseGraph, path: str | Path) -> None:
    """Write all nodes as vertices, and odometry and closures as edges.

    Information is of (translation, quaternion's vector part) of ``Z^-1 T_true``; that of a closure is multiplied by
    how much of it would count without submaps, which have no form in g2o. Unconnected logs share no frame, but their
    vertices are in the same file. Fixed points are vertices after the nodes.
    """
    # No comment: Ceres' reader takes none.
    lines = [g2o_vertex(k, graph.pose(k)) for k in range(len(graph.p))]
    for k in graph.edges.first.tolist():
        # Odometry keeps its axes from node to node: errors in the first's are errors in the second's.
        lines.append(g2o_edge(k, k + 1, *graph.odometry(k)))
    lines += [
        g2o_edge(c.first, c.second, c.T_first_second, c.covariance / weight)
        for c, weight in zip(graph.closures, (graph.ties.weight / shared(graph)).tolist(), strict=True)
        if weight > np.finfo(float).eps
    ]
    if graph.fixed is not None:
        lines += _fixed(graph, graph.fixed)
    with atomic_write(path) as stream:
        stream.write("\n".join([*lines, ""]).encode())


def _fixed(graph: PoseGraph, fixed: FixedPoints) -> Iterator[str]:
    """Fixed points as vertices, each with an edge from the nearer of its nodes, and one from the first of them."""
    n, nodes = len(graph.p), np.where(fixed.share > 0.5, fixed.other, fixed.one)
    for k, (node, a, x, sd) in enumerate(zip(nodes.tolist(), fixed.position, fixed.x, fixed.sd, strict=True)):
        yield g2o_vertex(n + k, RigidTransform.from_translation(a))
        Z = RigidTransform.from_components(x - graph.start[node], graph.pose(node).rotation.inv())
        # Which way its axes point is not seen.
        yield g2o_edge(node, n + k, Z, np.diag(np.repeat([FREE**2, sd**2], 3)))
        if k:
            T = RigidTransform.from_translation(a - fixed.position[0])
            yield g2o_edge(n, n + k, T, SURE**2 * np.eye(6))
