# SPDX-License-Identifier: BSD-3-Clause
"""The best of many poses, without those that nearly repeat a better one."""

import numpy as np

from magmatch.compiled import compiled_ahead
from magmatch.typing import Indices, Points, Scalars, Tensors


def distinct_poses(
    rotations: Tensors, centers: Points, scores: Scalars, angle: float, distance: float, limit: int
) -> Indices:
    """Best poses that differ from every better one by an angle (rad) or by the position of the centre (m)."""
    order = np.argsort(-scores, kind="stable")
    kept = np.zeros(min(limit, len(order)), dtype=np.int64)
    n = _first_distinct(rotations[order], centers[order], 1 + 2 * np.cos(angle), distance**2, kept)
    return np.asarray(order[kept[:n]], dtype=np.int64)


@compiled_ahead("f8[:,:,::1], f8[:,::1], f8, f8, i8[::1]")
def _first_distinct(R, centers, least_trace, distance2, kept):  # type: ignore[no-untyped-def]
    """List rows that no kept row before them resembles (trace of the relative rotation, squared distance)."""
    n = 0
    for row in range(len(R)):
        is_new = n < len(kept)
        for k in range(n):
            d2, trace = 0.0, 0.0
            for c in range(3):
                step = centers[kept[k], c] - centers[row, c]
                d2 += step * step
            if d2 < distance2:
                for a in range(3):
                    for b in range(3):
                        trace += R[kept[k], a, b] * R[row, a, b]
                if trace > least_trace:
                    is_new = False
                    break
        if is_new:
            kept[n] = row
            n += 1
            if n == len(kept):
                break
    return n
