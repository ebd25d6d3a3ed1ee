# SPDX-License-Identifier: BSD-3-Clause
"""The field of point dipoles, of which most fields in these tests are made."""

import numpy as np


def dipoles(points, places, moments):
    """Field at points, T; mu0 / 4 pi is in the moments, T m^3. One coordinate after the other, for speed."""
    r, moments = points.T[:, :, None] - np.asarray(places, float).T[:, None], np.asarray(moments, float)
    d2 = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
    per_d3 = 1 / (d2 * np.sqrt(d2))
    along = np.einsum("anm,ma->nm", r, moments)
    return np.einsum("nm,anm->na", 3 * along * per_d3 / d2, r) - per_d3 @ moments
