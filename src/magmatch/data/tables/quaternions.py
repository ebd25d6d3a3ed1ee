# SPDX-License-Identifier: BSD-3-Clause
"""Orientations from the quaternion columns of a file."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.tables.table import Table
from magmatch.errors import DataFormatError

QUATERNION = ("qx", "qy", "qz", "qw")
# Two decimals, the coarsest rounding seen in logs, move the norm by at most 1 %; more than 5 % is no quaternion.
MAX_NORM_ERROR = 0.05


def rotations_of(table: Table) -> Rotation | None:
    """Orientations of a table's rows."""
    present = [name for name in QUATERNION if table.has(name)]
    if not present:
        return None
    if len(present) < len(QUATERNION):
        missing = ", ".join(name for name in QUATERNION if name not in present)
        message = f"half a quaternion: found {', '.join(present)}, missing {missing}"
        raise DataFormatError(table.path, message, column=missing)
    quaternions = table.stack(*QUATERNION)
    with np.errstate(over="ignore"):  # absurd numbers become infinite, and are refused as such
        norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(norms - 1) > MAX_NORM_ERROR)
    if len(wrong):
        row = int(wrong[0])
        found = "a zero quaternion" if norms[row] == 0 else f"one of length {norms[row]:.4g}"
        message = f"expected a unit quaternion, found {found}"
        raise DataFormatError(table.path, message, line=int(table.line_numbers[row]), column="qx..qw")
    return Rotation.from_quat(quaternions)
