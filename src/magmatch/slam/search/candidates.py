# SPDX-License-Identifier: BSD-3-Clause
"""Where a window may lie beside a node."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import transform_from_matrix
from magmatch.slam.search.loop_closure import Match
from magmatch.typing import Matrix

# Of a candidate as it is kept.
N_NUMBERS = 123


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A node near which a window may lie, and the relative pose."""

    node: int
    T_node_window: RigidTransform
    match: Match


def numbers_of(candidates: Sequence[Candidate]) -> Matrix:
    """Candidates as rows of numbers, as they are kept."""
    rows = [
        np.concatenate([
            [c.node, c.match.log_odds, c.match.log_prior], c.T_node_window.as_matrix().ravel(),
            c.match.T_base_log.as_matrix().ravel(), c.match.covariance.ravel(),
            c.match.T_node_alone.as_matrix().ravel(), c.match.covariance_alone.ravel(),
        ])
        for c in candidates
    ]  # fmt: skip
    return np.array(rows).reshape(-1, N_NUMBERS)


def of_numbers(rows: Matrix) -> list[Candidate]:
    """Candidates of such rows."""
    found = []
    for row in rows.reshape(-1, N_NUMBERS):
        poses = (row[3:19], row[19:35], row[71:87])
        T_node_window, T_base_log, T_node_alone = (transform_from_matrix(part.reshape(4, 4)) for part in poses)
        C, alone = (part.reshape(6, 6) for part in (row[35:71], row[87:]))
        match = Match(T_base_log, C, float(row[1]), float(row[2]), T_node_alone, alone)
        found.append(Candidate(int(row[0]), T_node_window, match))
    return found
