# SPDX-License-Identifier: BSD-3-Clause
"""TUM trajectories: rows ``t x y z qx qy qz qw``, separated by white space; a header may name another order."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import atomic_write
from magmatch.data.tables.ordered_table import read_ordered
from magmatch.data.tables.table import Table
from magmatch.data.units import LengthUnit
from magmatch.typing import Points, Scalars

TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_tum(path: str | Path, length_unit: LengthUnit = "m") -> Table:
    """Read the rows of a TUM file, or of any table that names these columns; times in s."""
    return read_ordered(path, TUM_COLUMNS, length_unit=length_unit)[0]


def write_poses(path: str | Path, times: Scalars, poses: RigidTransform | None) -> None:
    """Write poses in TUM layout; None, where there are none, makes a file without lines of data."""
    if poses is None:
        write_tum(path, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    else:
        write_tum(path, times, poses.translation, poses.rotation.as_quat())


def write_tum(path: str | Path, times: Scalars, positions: Points, quaternions: np.ndarray) -> None:
    """Write a trajectory in TUM layout."""
    rows = np.column_stack([times, positions, quaternions]).tolist()
    lines = [f"# {' '.join(TUM_COLUMNS)}", *(" ".join(map(repr, row)) for row in rows), ""]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines).encode())
