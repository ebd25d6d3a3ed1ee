# SPDX-License-Identifier: BSD-3-Clause
"""How closely splines lie, and how far beyond the samples they reach."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_layout import SplineLayout

H = Hyperparameters(1.0, 1e-6, 1e-7, 0.2, divergence_weight=3000.0, reach=1.5)


def box(n, height, seed=0):
    return np.random.default_rng(seed).uniform(0, [3, 3, height], (n, 3))


def test_few_samples_have_closer_splines_against_their_distance():
    few, many = (SplineLayout.over(box(n, 1.0)) for n in (400, 1500))
    assert few.closest / few.distance < many.closest / many.distance
    assert many.closest < few.closest


@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0])
def test_a_plane_is_thin_however_it_lies(tilt):
    turn = Rotation.from_euler("xz", [tilt, 40.0], degrees=True)
    plane, volume = (turn.apply(box(500, height)) for height in (0.02, 1.0))
    reach = [SplineLayout.over(p).extrapolating(p, H).reach for p in (plane, volume)]
    assert reach == pytest.approx([0.6 * 5 + 0.5, 0.3 * 5 + 0.5])
