# SPDX-License-Identifier: BSD-3-Clause
"""Samples as they arrive: rows of position and field in the map frame, checked."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.arguments import numbers_of
from magmatch.data.checks import MAX_EXTENT, MAX_FIELD
from magmatch.errors import SurveyError
from magmatch.typing import Points, Vectors

# Largest distance from the first sample, m, and largest component, T.
LIMITS = np.r_[np.full(3, MAX_EXTENT), np.full(3, MAX_FIELD)]


def sample_rows(position: Points, field: Vectors, orientation: np.ndarray | None) -> np.ndarray:
    """Position and field in the map frame, one row a sample: (n, 6)."""
    p, b = numbers_of(position, "position", "(n, 3), in m"), numbers_of(field, "field", "(n, 3), in T")
    if p.shape != b.shape or p.shape[-1:] != (3,) or p.ndim > 2:
        msg = f"expected position and field both (3,) or both (n, 3), got {p.shape} and {b.shape}"
        raise ValueError(msg)
    if orientation is not None:
        q = numbers_of(orientation, "orientation", "(n, 4)")
        if q.shape != (*p.shape[:-1], 4):
            msg = f"expected orientation {(*p.shape[:-1], 4)}, quaternions xyzw, got {q.shape}"
            raise ValueError(msg)
        norm = np.linalg.norm(q, axis=-1)
        if not np.all(np.abs(norm - 1.0) < 1e-3):
            msg = f"expected orientation as unit quaternions xyzw, got one of length {np.ravel(norm)[0]:.3g}"
            raise SurveyError(msg)
        b = Rotation.from_quat(q).apply(b)
    rows = np.empty((p.size // 3, 6))
    rows[:, :3], rows[:, 3:] = p, b
    return rows


def check_samples(rows: np.ndarray, start: np.ndarray) -> None:
    """Refuse what no magnetometer on a walk from ``start`` (m) reports."""
    offsets = np.abs(rows - np.r_[start, 0.0, 0.0, 0.0])
    is_good = (offsets <= LIMITS).all(axis=1)
    if is_good.all():
        return
    bad = int(np.argmin(is_good))
    found = f"sample {bad}: position {rows[bad, :3]} m, field {rows[bad, 3:]} T"
    if not np.isfinite(rows[bad]).all():
        msg = f"{found}: expected finite numbers, got NaN or infinity; leave it out"
    elif np.abs(rows[bad, 3:]).max() > MAX_FIELD:
        msg = f"{found}: expected a field below {MAX_FIELD} T; is it in tesla?"
    else:
        msg = f"{found}: expected a position within {MAX_EXTENT / 1e3:.0f} km of the first; is it in metres?"
    raise SurveyError(msg)
