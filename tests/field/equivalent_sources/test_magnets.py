# SPDX-License-Identifier: BSD-3-Clause
"""The arithmetic of a search for magnets, against the field of a dipole and its differences."""

import numpy as np

from dipoles import dipoles
from magmatch.field.equivalent_sources.magnets import dipole_slopes, find_magnets, magnet_charges

NOISE = 0.4e-6
RNG = np.random.default_rng(0)
X = RNG.uniform(0, [1.0, 0.8, 0.1], (60, 3))
AT, MOMENTS = RNG.uniform([0, 0, -0.3], [1.0, 0.8, -0.1], (4, 3)), RNG.normal(size=(4, 3))


def field(at, moment):
    return dipoles(X, [at], [moment])


def test_slopes_are_differences_of_the_field_as_a_dipole_moves():
    slopes, step = dipole_slopes(X, AT, MOMENTS).reshape(4, 3, -1, 3), 1e-6
    for k in range(4):
        for axis, found in zip(step * np.eye(3), slopes[k], strict=True):
            expected = (field(AT[k] + axis, MOMENTS[k]) - field(AT[k] - axis, MOMENTS[k])) / (2 * step)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def over_a_floor():
    x, y = np.meshgrid(np.arange(0, 1, 0.02), np.arange(0, 0.8, 0.1))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.1)], axis=1)


def test_magnets_that_are_found_explain_as_much_as_the_true_ones_however_many_and_close():
    lanes, rng = over_a_floor(), np.random.default_rng(2)
    magnets = np.c_[rng.uniform(0.1, 0.9, 10), rng.uniform(0.1, 0.7, 10), rng.uniform(-0.05, 0.06, 10)]
    moments = 1e-7 * rng.normal(size=(10, 3))
    field = dipoles(lanes, magnets, moments) + rng.normal(scale=NOISE, size=lanes.shape)

    def left(at, moments):
        """Beside what changes linearly."""
        A, b = np.c_[np.ones(len(lanes)), lanes], field - dipoles(lanes, at, moments)
        return np.linalg.norm(b - A @ np.linalg.lstsq(A, b)[0])

    assert left(*find_magnets(lanes, field, 0.3)) <= left(magnets, moments)


def test_noise_on_a_field_that_changes_linearly_shows_no_magnet():
    lanes = over_a_floor()
    field = lanes @ np.diag([2e-6, -1e-6, -1e-6]) + np.random.default_rng(0).normal(scale=NOISE, size=lanes.shape)
    assert [part.shape for part in find_magnets(lanes, field, 0.3)] == [(0, 3), (0, 3)]


def test_no_magnet_is_moved_onto_the_sample_that_it_would_explain():
    lanes, at = over_a_floor(), np.array([[0.3, 0.4, 0.03]])
    field = dipoles(lanes, at, 1e-7 * np.eye(3)[2:]) + np.random.default_rng(1).normal(scale=NOISE, size=lanes.shape)
    field[[190, 290]] += [[0, 0, 60e-6], [40e-6, 0, 0]]
    found, _ = find_magnets(lanes, field, 0.3)
    assert len(found) > 1
    assert np.linalg.norm(found - at, axis=1).min() < 0.01
    # Half the distance of neighbours.
    assert np.linalg.norm(found[:, None] - lanes, axis=2).min() > 0.01


def test_magnets_and_their_moments_are_found_in_any_frame_and_unit():
    lanes = over_a_floor()
    at, moment = np.array([0.31, 0.42, 0.02]), 1e-8 * np.array([0.5, 1.0, 3.0])
    b = dipoles(lanes, [at], [moment]) + 2e-7 * np.random.default_rng(1).normal(size=lanes.shape)
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    for R, shift, unit in ((np.eye(3), 0.0, 1.0), (turn, 7.0, 1e6)):
        # One magnet explains all: no second one is worth its numbers.
        found, moments = find_magnets(lanes @ R.T + shift, unit * b @ R.T, 0.3)
        np.testing.assert_allclose(found, [R @ at + shift], rtol=0, atol=2e-3)
        np.testing.assert_allclose(moments, [unit * R @ moment], rtol=0, atol=0.05 * unit * 3e-8)
        charges, magnet, strength = magnet_charges(lanes @ R.T + shift, unit * b @ R.T, 0.3)
        away = np.linalg.norm(charges - found, axis=1)
        # A seventh stands in the middle, six around it at a fifth of the distance from the nearest sample.
        size = 0.2 * np.linalg.norm(lanes @ R.T + shift - found, axis=1).min()
        np.testing.assert_allclose(np.sort(away), [0, *[size] * 6], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(charges.mean(axis=0), found[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(strength, np.linalg.norm(moments) / size, rtol=1e-9)
        assert magnet.tolist() == [0] * 7
