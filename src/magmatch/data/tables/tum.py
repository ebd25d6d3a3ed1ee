# SPDX-License-Identifier: BSD-3-Clause
"""TUM trajectories: rows ``t x y z qx qy qz qw``, separated by white space; a header may name another order."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import write_whole
from magmatch.number_text import exact
from magmatch.typing import Points, Scalars

TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def write_poses(path: str | Path, times: Scalars, poses: RigidTransform | None) -> None:
    """Write poses in TUM layout; None, where there are none, makes a file without lines of data."""
    if poses is None:
        write_tum(path, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    else:
        write_tum(path, times, poses.translation, poses.rotation.as_quat())


def write_tum(path: str | Path, times: Scalars, positions: Points, quaternions: np.ndarray, of: str = "") -> None:
    """Write a trajectory in TUM layout; the comment above it says what it is `of`."""
    rows = np.column_stack([times, positions, quaternions])
    lines = [f"# {of}{' '.join(TUM_COLUMNS)}", *(" ".join(exact(row)) for row in rows), ""]
    write_whole(path, "\n".join(lines).encode())
