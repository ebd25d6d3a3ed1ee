# SPDX-License-Identifier: BSD-3-Clause
"""Structures stand where they may, and are as strong as asked."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.simulation.magnets import Cuboid, Cylinder, field_of
from magmatch.simulation.structures import around_box, calibrated, is_clear, rearranged, under_table

SETTINGS = settings(deadline=None, max_examples=20)
HIGH = np.array([1.5, 1.5, 0.5])


def surface_points(source, rng, n=400):
    """Points on and in a body, world frame."""
    u = rng.uniform(-0.5, 0.5, (n, 3))
    if isinstance(source, Cuboid):
        local = np.concatenate([u, np.sign(u) / 2]) * source.size
    else:
        assert isinstance(source, Cylinder)
        angle = np.linspace(0, 2 * np.pi, n)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * source.diameter / 2
        local = np.column_stack([ring, u[:, 2] * source.height])
    return source.center + source.rotation.apply(local)


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 1.0))
def test_structures_around_a_box_keep_their_clearance(seed, clearance):
    rng = np.random.default_rng(seed)
    for source in around_box(-HIGH, HIGH, clearance, rng):
        beyond = np.abs(surface_points(source, rng)) - HIGH
        assert np.linalg.norm(np.maximum(beyond, 0), axis=1).min() >= clearance - 1e-9


def test_magnets_stick_under_the_table_top(rng):
    magnets = under_table((2.0, 1.5), 0.06, 20, rng)
    for magnet in magnets:
        points = surface_points(magnet, rng)
        assert points[:, 2].max() < -0.05
        assert (np.abs(points[:, :2]) <= (1.0, 0.75)).all()
    up = np.array([magnet.rotation.apply(magnet.polarization)[2] for magnet in magnets])
    assert up.min() < 0 < up.max()


def test_calibrated_room_varies_as_asked(rng):
    probes = rng.uniform(-HIGH, HIGH, (300, 3))
    sources = calibrated(around_box(-HIGH, HIGH, 0.3, rng), probes, 15e-6)
    field = field_of(sources, probes)
    assert np.sqrt(field.var(axis=0).sum()) == pytest.approx(15e-6, rel=1e-9)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 1.0])
def test_the_fraction_asked_for_moves_and_stays_clear(rng, fraction):
    samples = rng.uniform(-HIGH, HIGH, (300, 3))
    before = around_box(-HIGH, HIGH, 0.3, rng)
    after = rearranged(before, fraction, samples, 0.3, rng)
    distance = np.array([np.linalg.norm(a.center - b.center) for a, b in zip(after, before, strict=True)])
    assert (distance > 0).sum() == round(fraction * len(before))
    assert ((distance == 0) | ((distance > 0.3 - 1e-9) & (distance < 0.8 + 1e-9))).all()
    assert is_clear(after, samples, 0.3 - 1e-9).all()


def test_what_cannot_move_clear_stays(rng):
    before = around_box(-HIGH, HIGH, 0.3, rng)[:1]
    crowd = before[0].center + 3 * np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, 61)]), -1).reshape(-1, 3)
    outside = crowd[before[0].distance_to(crowd) > 0.3]
    assert rearranged(before, 1.0, outside, 0.3, rng)[0] is before[0]
