# SPDX-License-Identifier: BSD-3-Clause
"""Files of a session's graph: for other programs in the format of g2o, and poses with their covariances."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.tables.table import write_table
from magmatch.geometry import adjoint
from magmatch.number_text import exact
from magmatch.registration.g2o import Edge, RotationTangent, write_pose_graph
from magmatch.slam.graph.block_cholesky import SIDE
from magmatch.slam.graph.factors import FixedPoints
from magmatch.slam.graph.normal_equations import shared
from magmatch.slam.graph.pose_graph import FREE, SURE, PoseGraph
from magmatch.slam.session import Session
from magmatch.typing import Scalars

UPPER = np.triu_indices(SIDE)
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
COLUMNS = (*POSE, *(f"c{i}{j}" for i, j in zip(*UPPER, strict=True)))


def write_covariances(session: Session, path: Path) -> None:
    """Write the body's pose at the middle of each window in its component's frame, and covariance.

    It is of xi, rotation first (rad, m), in ``T_true = T Exp(xi)``, by rows of its upper triangle: against the first
    node of the component, or in the frame of the fixed points. A rigid survey has the pose of its frame; without
    times, t is "".
    """
    graph, logs, components, moments, numbers = session.graph, [], [], [], []
    for name, component, one in zip(session.names, session.component_of, session.paths, strict=True):
        for node, about_node in zip(one.nodes.tolist(), graph.covariances(one.nodes), strict=True):
            T_node_body, t, _ = session._now.body_at(node)
            T, M = graph.pose(node) * T_node_body, adjoint(T_node_body.inv())
            C = M @ about_node @ M.T
            # The first node's is zero, but for rounding.
            np.fill_diagonal(C, np.maximum(np.diagonal(C), 0.0))
            logs.append(name)
            components.append(component)
            moments += [""] if t is None else exact([t])
            numbers.append([*T.translation, *T.rotation.as_quat(), *C[UPPER]])
    columns: dict[str, Scalars | list[str]] = {"log": logs, "component": np.array(components), "t": moments}
    write_table(path, columns | dict(zip(COLUMNS, np.array(numbers).T, strict=True)))


def write_graph(graph: PoseGraph, path: str | Path, tangent: RotationTangent = "quaternion") -> None:
    """Write all nodes as vertices, and odometry and closures as edges.

    Information is of ``Z^-1 T_true``, translation first (``tangent``: see `g2o_information`); that of a closure is
    multiplied by how much of it would count without submaps, which have no form in g2o. Unconnected logs share no
    frame, but their vertices are in the same file. Fixed points are vertices after the nodes.
    """
    vertices = [graph.pose(k) for k in range(len(graph.p))]
    # Odometry keeps its axes from node to node: errors in the first's are errors in the second's.
    edges = [Edge(k, k + 1, *graph.odometry(k)) for k in graph.edges.first.tolist()]
    edges += [
        Edge(c.first, c.second, c.T_first_second, c.covariance / weight)
        for c, weight in zip(graph.closures, (graph.as_arrays.weight / shared(graph)).tolist(), strict=True)
        if weight > np.finfo(float).eps
    ]
    if graph.fixed is not None:
        vertices += [RigidTransform.from_translation(a) for a in graph.fixed.position]
        edges += _to_fixed(graph, graph.fixed)
    write_pose_graph(path, vertices, edges, tangent)


def _to_fixed(graph: PoseGraph, fixed: FixedPoints) -> Iterator[Edge]:
    """Edges to fixed points: each from the nearer of its nodes, and one from the first of them."""
    n, nodes = len(graph.p), np.where(fixed.share > 0.5, fixed.other, fixed.one)
    for k, (node, a, x, sd) in enumerate(zip(nodes.tolist(), fixed.position, fixed.x, fixed.sd, strict=True)):
        Z = RigidTransform.from_components(x - graph.start[node], graph.pose(node).rotation.inv())
        # Which way its axes point is not seen.
        yield Edge(node, n + k, Z, np.diag(np.repeat([FREE**2, sd**2], 3)))
        if k:
            T = RigidTransform.from_translation(a - fixed.position[0])
            yield Edge(n, n + k, T, SURE**2 * np.eye(6))
