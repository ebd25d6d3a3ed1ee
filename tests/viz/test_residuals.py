# SPDX-License-Identifier: BSD-3-Clause
"""Residuals say how well the base explains the target, in standard deviations."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.viz.figures.agreement_figures import LARGEST_ORDINARY, compare


def test_the_truth_leaves_ordinary_residuals(pair):
    compared = compare(
        pair.base_map, pair.target_map, pair.accepted.T_base_target, replace(pair.accepted, sensor=None)
    )
    assert compared.overlap > 0.9
    assert compared.rms < LARGEST_ORDINARY


def test_a_wrong_pose_leaves_large_ones(pair):
    T = pair.accepted.T_base_target * RigidTransform.from_translation([0.5, 0, 0])
    right = compare(pair.base_map, pair.target_map, pair.accepted.T_base_target, pair.accepted)
    wrong = compare(pair.base_map, pair.target_map, T, pair.accepted)
    assert wrong.rms > 5 * right.rms
    assert wrong.is_large.mean() > 0.3


def test_few_bad_samples_spoil_the_root_mean_square_and_not_the_typical_residual(pair):
    field = pair.target.field.copy()
    field[::20] += 3e-5
    spoiled = replace(pair.target, field=field)
    clean, bad = (
        compare(pair.base_map, s, pair.accepted.T_base_target, pair.accepted) for s in (pair.target, spoiled)
    )
    assert bad.rms > 3 * clean.rms
    assert bad.typical < 1.3 * clean.typical


def test_far_away_nothing_overlaps_and_nothing_is_claimed(pair):
    T = RigidTransform.from_translation([100.0, 0, 0])
    compared = compare(pair.base_map, pair.target_map, T, pair.accepted)
    assert compared.overlap == 0
    assert compared.rms is None
    assert compared.typical is None
    assert not compared.is_large.any()


def test_the_sensors_difference_is_taken_off(pair):
    gain = np.diag([1.01, 0.99, 1.02])
    bias = np.array([1e-6, -2e-6, 3e-6])
    spoiled = replace(pair.target, field=pair.target.field @ gain.T + bias)
    result = replace(pair.accepted, sensor={"bias": bias.tolist(), "gain": gain.tolist()})
    plain = compare(pair.base_map, pair.target, result.T_base_target, replace(result, sensor=None))
    mended = compare(pair.base_map, spoiled, result.T_base_target, result)
    np.testing.assert_allclose(mended.measured, plain.measured, atol=1e-15)
