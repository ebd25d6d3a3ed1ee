# SPDX-License-Identifier: BSD-3-Clause
"""How odometry bends a path: the slopes of a dead reckoning that is off by a little."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.bending import bend, lasting_errors

RNG = np.random.default_rng(3)
PATH = np.cumsum(RNG.normal(size=(9, 3)), axis=0)
STEPS = np.diff(PATH, axis=0)
LENGTHS = np.linalg.norm(STEPS, axis=1)
CONFIG = OdometryConfig(sd=(0.4, 5.0), scale_sd=0.03, turn_share=0.4)
SMALL = 1e-7


def dead_reckoned(turns, shifts, scale, about):
    """Turn and shift of each point, where each step turns about its middle, and one point stays as it was."""
    R, p = [Rotation.identity()], [PATH[0]]
    for step, turn, shift in zip(STEPS, turns, shifts, strict=True):
        half = (1 + scale) * step / 2
        R.append(R[-1] * Rotation.from_rotvec(turn))
        p.append(p[-1] + R[-2].apply(half) + R[-1].apply(half) + R[-2].apply(shift))
    back = R[about].inv()
    return (
        np.array([(back * r).as_rotvec() for r in R]),
        np.array([back.apply(q - p[about]) + PATH[about] for q in p]) - PATH,
    )


@pytest.mark.parametrize("about", [0, 4, 8])
@pytest.mark.parametrize(("upright", "planar"), [(False, False), (True, False), (True, True)])
def test_loads_are_the_slopes_of_dead_reckoning(about, upright, planar):
    loads = bend(PATH, about, CONFIG, upright=upright, planar=planar)
    turning, moving = ([2] if upright else [0, 1, 2]), ([0, 1] if planar else [0, 1, 2])
    n = len(STEPS)
    assert loads.shape == (len(PATH), 6, n * (len(turning) + len(moving)) + 2)
    column = 0
    for kind, axes, sd in (("turn", turning, CONFIG.rotation_sd), ("shift", moving, CONFIG.translation_sd)):
        for axis in axes:
            for k in range(n):
                errors = np.zeros((n, 3))
                errors[k, axis] = SMALL * sd * np.sqrt(LENGTHS[k])
                turns, shifts = (errors, 0 * errors) if kind == "turn" else (0 * errors, errors)
                expected = np.concatenate(dead_reckoned(turns, shifts, 0.0, about), axis=1) / SMALL
                np.testing.assert_allclose(loads[:, :, column], expected, atol=1e-4)
                column += 1


@pytest.mark.parametrize("about", [0, 5])
def test_lasting_errors_are_the_slopes_of_scale_and_turn_rate(about):
    found = lasting_errors(PATH, about, upright=True)
    none = np.zeros((len(STEPS), 3))
    scaled = np.concatenate(dead_reckoned(none, none, SMALL, about), axis=1) / SMALL
    turned_on = dead_reckoned(SMALL * LENGTHS[:, None] * [0.0, 0.0, 1.0], none, 0.0, about)
    np.testing.assert_allclose(found[:, :, 0], scaled, atol=1e-4)
    np.testing.assert_allclose(found[:, :, 1], np.concatenate(turned_on, axis=1) / SMALL, atol=1e-4)


def test_without_an_upright_carrier_no_turn_rate_lasts():
    assert not lasting_errors(PATH, 0, upright=False)[:, :, 1].any()
