# SPDX-License-Identifier: BSD-3-Clause
"""The field of point dipoles, of which most fields in these tests are made."""

import numpy as np


def dipoles(points, places, moments):
    """Field at points, T; mu0 / 4 pi is in the moments, T m^3."""
    r, moments = points[:, None] - np.asarray(places), np.asarray(moments)
    d = np.linalg.norm(r, axis=2, keepdims=True)
    along = (r * moments).sum(axis=2, keepdims=True)
    return (3 * along * r / d**5 - moments / d**3).sum(axis=1)
