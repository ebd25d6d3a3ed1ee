# SPDX-License-Identifier: BSD-3-Clause
"""The graph for other programs: g2o's vertices, and its edges with their information."""

from pathlib import Path

import numpy as np

from magmatch.atomic import atomic_write
from magmatch.registration.to_other_programs import g2o_edge, g2o_vertex
from magmatch.slam.graph.pose_graph import PoseGraph


def write_graph(graph: PoseGraph, path: str | Path) -> None:
    """Write all nodes as vertices, and odometry and closures as edges.

    Of a closure the information is what the graph left of it: its own times its weight. Two logs that nothing ties
    share no frame; their vertices stand in one file all the same.
    """
    lines = ["# magmatch: information of (translation, quaternion's vector part) of Z^-1 T_true"]
    lines += [g2o_vertex(k, graph.pose(k)) for k in range(len(graph.p))]
    for k in graph.edges.first.tolist():
        # Odometry keeps its axes from node to node: errors in the first's are errors in the second's.
        lines.append(g2o_edge(k, k + 1, *graph.odometry(k)))
    lines += [
        g2o_edge(c.first, c.second, c.T_first_second, c.covariance / c.weight)
        for c in graph.closures
        if c.weight > np.finfo(float).eps
    ]
    with atomic_write(path) as stream:
        stream.write("\n".join([*lines, ""]).encode())
