# SPDX-License-Identifier: BSD-3-Clause
"""Sources against the dipole formula and against Maxwell's equations."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import constants
from scipy.spatial.transform import Rotation

from magmatch.errors import MissingExtraError
from magmatch.simulation.magnets import Cuboid, Cylinder, Dipole, field_of

MU0 = constants.mu_0
SETTINGS = settings(deadline=None, max_examples=20)
seeds = st.integers(0, 2**32 - 1)


def dipole_formula(center, moment, points):
    r = points - center
    d = np.linalg.norm(r, axis=1, keepdims=True)
    return MU0 / (4 * np.pi) * (3 * r * (r @ moment)[:, None] / d**5 - moment / d**3)


def directions(rng, n=50):
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def some_sources(rng):
    turns = Rotation.random(2, rng=rng)
    return [
        Cuboid(rng.normal(size=3), rng.uniform(0.1, 0.5, 3), rng.normal(size=3) * 1e-3, turns[0]),
        Cylinder(rng.normal(size=3), 0.2, 0.6, rng.normal(size=3) * 1e-3, turns[1]),
        Dipole(rng.normal(size=3), rng.normal(size=3)),
    ]


@SETTINGS
@given(seeds)
def test_dipole_follows_its_formula(seed):
    rng = np.random.default_rng(seed)
    center, moment, points = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(20, 3)) + 3
    expected = dipole_formula(center, moment, points)
    np.testing.assert_allclose(
        field_of([Dipole(center, moment)], points), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
    )


@SETTINGS
@given(seeds)
def test_magnets_seen_from_afar_are_dipoles(seed):
    rng = np.random.default_rng(seed)
    size, polarization, turn = rng.uniform(0.02, 0.05, 3), rng.normal(size=3), Rotation.random(rng=rng)
    center = rng.normal(size=3)
    points = center + 2.0 * directions(rng)
    for magnet, volume in (
        (Cuboid(center, size, polarization, turn), size.prod()),
        (Cylinder(center, 0.03, 0.04, polarization, turn), np.pi * 0.015**2 * 0.04),
    ):
        expected = dipole_formula(center, turn.apply(polarization) * volume / MU0, points)
        error = np.linalg.norm(field_of([magnet], points) - expected, axis=1)
        # The first correction is of the order (half diagonal / distance)^2, here below (0.043 / 2)^2.
        assert (error < 5e-4 * np.linalg.norm(expected, axis=1).max()).all()


def test_many_points_in_pieces_give_the_same_field(monkeypatch, rng):
    sources, points = some_sources(rng), rng.normal(size=(100, 3)) + 4
    whole = field_of(sources, points)
    monkeypatch.setattr("magmatch.simulation.magnets._PAIRS_AT_ONCE", 40)
    np.testing.assert_allclose(field_of(sources, points), whole, rtol=1e-12)


def test_inside_a_magnet_and_on_its_surface_the_field_is_finite_and_at_a_dipole_it_is_refused():
    at = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [0.5, 0.5, 0.5]])
    J, unturned = np.array([0, 0, 1.0]), Rotation.identity()
    for body in (Cuboid(np.zeros(3), np.ones(3), J, unturned), Cylinder(np.zeros(3), 1.0, 1.0, J, unturned)):
        assert np.isfinite(field_of([body], at)).all()
    with pytest.raises(ValueError, match="found point 0"):
        field_of([Dipole(np.zeros(3), J)], at)


def test_without_magpylib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "magpylib", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[simulation\]'"):
        field_of([Dipole(np.zeros(3), np.ones(3))], np.ones((1, 3)))


def test_distance_is_measured_to_the_surface():
    quarter_turn = Rotation.from_euler("z", 90, degrees=True)
    box = Cuboid(np.zeros(3), np.array([2.0, 4.0, 6.0]), np.ones(3), quarter_turn)
    points = np.array([[3.0, 0, 0], [0, 3, 0], [0, 0, 3.5], [5, 5, 0], [0.1, 0.1, 0.1]])
    np.testing.assert_allclose(box.distance_to(points), [1, 2, 0.5, 5, 0], atol=1e-12)
    can = Cylinder(np.zeros(3), 2.0, 6.0, np.ones(3), Rotation.identity())
    np.testing.assert_allclose(can.distance_to(points), [2, 2, 0.5, np.hypot(5, 5) - 1, 0], atol=1e-12)
    np.testing.assert_allclose(Dipole(np.zeros(3), np.ones(3)).distance_to(points[:2]), [3, 3])
