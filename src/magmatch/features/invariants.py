# SPDX-License-Identifier: BSD-3-Clause
"""A frame and a descriptor at every single point, from the field and its gradient there.

In source-free air the gradient is symmetric and traceless, so field and gradient hold eight numbers, five of them
rotation invariants; the field B and the vector G B span a full frame. No neighbourhood is needed, so nothing breaks
at the edge of an overlap.
"""

import numpy as np

from magmatch.field.values import gradient_norm
from magmatch.geometry import unit_vectors
from magmatch.typing import Matrix, Tensors, Vectors

# Keeps quotients finite where the gradient vanishes; far below any measurable gradient, T/m.
_TINY_GRADIENT = 1e-15


def traceless_symmetric(gradient: Tensors) -> Tensors:
    """Nearest gradient (T/m) that obeys both of Maxwell's laws in air: symmetric, trace zero."""
    symmetric = (gradient + np.swapaxes(gradient, 1, 2)) / 2
    trace = np.trace(symmetric, axis1=1, axis2=2) / 3
    return np.asarray(symmetric - trace[:, None, None] * np.eye(3))


def rotation_invariants(field: Vectors, gradient: Tensors) -> Matrix:
    """Six numbers per point that no rotation of the survey changes, of a traceless symmetric gradient (T/m): (n, 6).

    ``|B|`` (T), ``|GB|/|B|`` (T/m), ``B.GB/|B|^2`` (T/m), ``|G|`` (T/m), ``det G/|G|^2`` (T/m) and the chirality
    ``3 B.(GB x GGB)/(|B|^2 |G|^2)`` (T/m).
    """
    b = np.maximum(np.linalg.norm(field, axis=1), np.finfo(float).tiny)
    GB = np.einsum("nij,nj->ni", gradient, field)
    GGB = np.einsum("nij,nj->ni", gradient, GB)
    g = gradient_norm(gradient) + _TINY_GRADIENT
    return np.stack(
        [
            b,
            np.linalg.norm(GB, axis=1) / b,
            np.einsum("ni,ni->n", field, GB) / b**2,
            g,
            np.linalg.det(gradient / g[:, None, None]) * g,
            3 * np.einsum("ni,ni->n", field, np.cross(GB, GGB)) / (b**2 * g**2),
        ],
        axis=1,
    )


def point_frames(field: Vectors, gradient: Tensors) -> Tensors:
    """Rotation matrices whose columns are axes in the map: along B, then in the plane of B and GB, right-handed.

    They are ill defined where B and GB are parallel.
    """
    GB = np.einsum("nij,nj->ni", gradient, field)
    first = unit_vectors(field)
    second = unit_vectors(GB - np.einsum("ni,ni->n", GB, first)[:, None] * first)
    return np.stack([first, second, np.cross(first, second)], axis=2)
