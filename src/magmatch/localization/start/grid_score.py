# SPDX-License-Identifier: BSD-3-Clause
"""Every place and heading of a stretch of path in a map, scored by squared residuals; the bias solved for at each."""

import numpy as np

from magmatch.compiled import compiled

# What a bin outside the map costs, in squared residuals, and the share of bins that may lie there.
OUTSIDE, MOST_OUTSIDE = 6.0, 1 / 3
# Cost of a pose that is none.
UNKNOWN = np.inf


@compiled
def score_all(anchors, stretches, ground, sd2, ridges, score):  # type: ignore[no-untyped-def]
    """Squared residuals at each anchor and heading, the better of the sensors' biases solved for (nearest points).

    `stretches`: (headings, n) array of STRETCH.
    """
    values, origin, spacing = ground.values, ground.origin, ground.spacing
    n = stretches.shape[1]
    for y in range(len(stretches)):
        for a in range(len(anchors)):
            h0, h1, h2, total, n_known = 0.0, 0.0, 0.0, 0.0, 0
            n_out = 0
            for m in range(n):
                q, f, R = stretches[y, m].q, stretches[y, m].f, stretches[y, m].R
                i = int(np.floor((anchors[a, 0] + q[0] - origin[0]) / spacing + 0.5))
                j = int(np.floor((anchors[a, 1] + q[1] - origin[1]) / spacing + 0.5))
                k = int(np.floor((anchors[a, 2] + q[2] - origin[2]) / spacing + 0.5))
                is_in = 0 <= i < values.shape[0] and 0 <= j < values.shape[1] and 0 <= k < values.shape[2]
                if not is_in or values[i, j, k, 3] < 0:
                    n_out += 1
                    if n_out > MOST_OUTSIDE * n:
                        break
                    continue
                r0, r1, r2 = (
                    f[0] - values[i, j, k, 0],
                    f[1] - values[i, j, k, 1],
                    f[2] - values[i, j, k, 2],
                )
                h0 += R[0, 0] * r0 + R[1, 0] * r1 + R[2, 0] * r2
                h1 += R[0, 1] * r0 + R[1, 1] * r1 + R[2, 1] * r2
                h2 += R[0, 2] * r0 + R[1, 2] * r1 + R[2, 2] * r2
                total += r0 * r0 + r1 * r1 + r2 * r2
                n_known += 1
            score[a, y] = UNKNOWN
            if n_out <= MOST_OUTSIDE * n and n_known > 0:
                h = h0 * h0 + h1 * h1 + h2 * h2
                best = UNKNOWN
                for b in range(len(ridges)):
                    # The bias's own price: half the log-determinant, twice.
                    price = 3 * np.log(1 + n_known / ridges[b])
                    best = min(best, (total - h / (n_known + ridges[b])) / sd2 + price)
                score[a, y] = best + OUTSIDE * n_out
