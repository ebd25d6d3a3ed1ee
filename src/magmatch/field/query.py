# SPDX-License-Identifier: BSD-3-Clause
"""A map evaluated at any number of points, as a table."""

import numpy as np

from magmatch.arguments import points_of
from magmatch.field.axis_grid import CHUNK
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, counted, followed
from magmatch.typing import Points, Scalars


def query_map(
    field_map: FieldMap, points: Points, *, with_gradient: bool = False, progress: Progress | None = None
) -> dict[str, Scalars]:
    """Evaluate a map at any number of points.

    Parameters
    ----------
    field_map : FieldMap
    points : (n, 3) array, m, map frame
    with_gradient : bool
        Add the gradient.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    dict of (n,) arrays
        ``x, y, z`` (m), ``bx, by, bz`` (T), ``sx, sy, sz`` (T, of the noise-free field), and ``bxx, bxy, ...`` (T/m)
        if requested; in the points' order.
    """
    p_map, parts = points_of(points), []
    starts = range(0, max(len(p_map), 1), CHUNK)
    with followed(progress):
        for start in counted(f"evaluating the map at {len(p_map)} points", starts):
            p = p_map[start : start + CHUNK]
            values = field_map.evaluate(p, order=1 if with_gradient else 0)
            sd = np.sqrt(np.maximum(np.diagonal(field_map.covariance(p), axis1=1, axis2=2), 0))
            blocks = [p, values.field, sd]
            if values.gradient is not None:
                blocks.append(values.gradient.reshape(-1, 9))
            parts.append(np.concatenate(blocks, axis=1))
    names = ["x", "y", "z", "bx", "by", "bz", "sx", "sy", "sz"]
    names += [f"b{a}{b}" for a in "xyz" for b in "xyz"] if with_gradient else []
    return dict(zip(names, np.concatenate(parts).T, strict=True))
