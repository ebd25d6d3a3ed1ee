# SPDX-License-Identifier: BSD-3-Clause
"""Poses with their covariances, one row for each window: formats of trajectories have no place for them."""

from pathlib import Path

import numpy as np

from magmatch.data.tables.table import write_table
from magmatch.geometry import adjoint
from magmatch.number_text import exact
from magmatch.slam.session import Session
from magmatch.slam.statement import body_at
from magmatch.typing import Scalars

UPPER = np.triu_indices(6)
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
COLUMNS = (*POSE, *(f"c{i}{j}" for i, j in zip(*UPPER, strict=True)))


def write_covariances(session: Session, path: Path) -> None:
    """Write the body's pose at the middle of each window in its component's frame, and covariance.

    It is of xi, rotation first (rad, m), in ``T_true = T Exp(xi)``, by rows of its upper triangle: against the first
    node of the component, or in the frame of the fixed points. Of a rigid survey, its frame. Without times t is "".
    """
    graph, logs, components, moments, numbers = session.graph, [], [], [], []
    for name, component, one in zip(session.names, session.component_of, session.paths, strict=True):
        for node, about_node in zip(one.nodes.tolist(), graph.covariances(one.nodes), strict=True):
            T_node_body, t, _ = body_at(one, node, is_rigid=session.is_rigid)
            T, M = graph.pose(node) * T_node_body, adjoint(T_node_body.inv())
            C = M @ about_node @ M.T
            # Of the first node it is zero, but for rounding.
            np.fill_diagonal(C, np.maximum(np.diagonal(C), 0.0))
            logs.append(name)
            components.append(component)
            moments += [""] if t is None else exact([t])
            numbers.append([*T.translation, *T.rotation.as_quat(), *C[UPPER]])
    columns: dict[str, Scalars | list[str]] = {"log": logs, "component": np.array(components), "t": moments}
    write_table(path, columns | dict(zip(COLUMNS, np.array(numbers).T, strict=True)))
