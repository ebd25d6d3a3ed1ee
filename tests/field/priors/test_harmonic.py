# SPDX-License-Identifier: BSD-3-Clause
"""Claims about equivalent sources: what they stand for, where they stand, and where they say nothing."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from dipoles import dipoles
from magmatch.field.domain import Box
from magmatch.field.equivalent_sources.shell import lay_shell
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated
from magmatch.field.priors.harmonic import SPACING_RATIO, HarmonicPrior
from magmatch.field.variogram import typical_length

EARTH = np.array([18e-6, 2e-6, -44e-6])
BOX = np.array([2.0, 1.5, 0.8])
H = Hyperparameters(lengthscale=0.5, signal_sd=12e-6, noise_sd=0.5e-6, spacing=0.35)


def field_at(points, seed=0, inside=False):
    """Earth's field and twelve dipoles 0.5 m below a box, one more in its middle if asked for."""
    rng = np.random.default_rng(seed)
    sources = [(rng.uniform([0, 0, -0.7], [2, 1.5, -0.5]), rng.normal(size=3)) for _ in range(12)]
    places, moments = zip(*sources, *[(BOX / 2, np.array([1.0, 1.0, 0.5]))] * inside, strict=True)
    return EARTH + dipoles(points, places, 1e-6 * np.array(moments))


def room(n=600, inside=False, noise_sd=0.5e-6):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, BOX, size=(n, 3))
    points = points[np.linalg.norm(points - BOX / 2, axis=1) > 0.3]
    return points, field_at(points, inside=inside) + rng.normal(scale=noise_sd, size=points.shape)


def test_charges_stand_around_the_region_and_fill_it_with_unit_variance():
    points, _ = room()
    shell = lay_shell(points, 0.4, 0.3, 2000)
    away = np.linalg.norm(shell.sources[:, None] - points, axis=2).min(axis=1)
    assert away.min() > 0.38
    assert away.max() < 0.41
    variance = (shell.design(points) ** 2).sum(axis=1).mean()
    assert variance == pytest.approx(1, rel=0.05)
    np.testing.assert_array_equal(
        shell.is_whole(np.array([[1.0, 0.7, 0.7], [-0.1, 0.7, 0.4], [-0.4, 0.7, 0.4]])), [1, 1, 0]
    )


def test_the_number_of_charges_is_bounded_whatever_is_asked():
    rng = np.random.default_rng(0)
    along, flat = (rng.uniform(0, size, size=(3000, 3)) for size in ([200.0, 1.0, 0.1], [1000.0, 1000.0, 0.0]))
    for region, distance in ((along, 0.3), (flat, 0.05), (room()[0], 0.01), (room()[0], 1e3)):
        shell = lay_shell(region, distance, 0.7 * distance, 300)
        assert 0 < len(shell.sources) <= 300
        assert shell.spacing / shell.distance == pytest.approx(0.7)


def test_what_is_affordable_is_what_a_layer_takes_that_stands_as_near_as_the_field_changes():
    points, field = room()
    length = typical_length(points, field)
    needed = {
        distance: len(lay_shell(points, distance * length, SPACING_RATIO * distance * length, 10**6).sources)
        for distance in (0.5, 1.0)
    }
    assert needed[1.0] < 0.5 * needed[0.5]
    for cap, expected in ((1.2 * needed[0.5], True), (1.2 * needed[1.0], True), (0.8 * needed[1.0], False)):
        prior = HarmonicPrior(max_sources=int(cap))
        assert prior.is_affordable(points, length) is expected
        assert prior.is_affordable(10 * points, 10 * length) is expected


def test_a_declared_box_is_kept_free_of_charges():
    T = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_rotvec([0.0, 0.0, 0.6]))
    box = Box(np.array([-0.5, -0.5, -0.5]), np.array([3.0, 2.0, 1.5]), T)
    model = HarmonicPrior(box=box).build(*room(), H)
    p_box = T.apply(model.basis.sources)
    beyond = np.linalg.norm(np.maximum(np.maximum(box.low - p_box, p_box - box.high), 0), axis=1)
    assert beyond.min() > 0.25
    corner = T.inv().apply(box.high[None] - 0.05)
    assert model.basis.is_whole(corner).all()
    assert not HarmonicPrior().build(*room(), H).basis.is_whole(corner).any()


def test_a_huge_box_takes_a_coarser_layer_not_the_machine():
    box = Box(np.full(3, -1e4), np.full(3, 1e4), RigidTransform.identity())
    model = HarmonicPrior(box, max_sources=500).build(*room(), H)
    assert model.basis.n_weights <= 500
    assert model.basis.distance > 100


def test_the_field_above_a_plane_is_found():
    points, _ = room(800)
    points[:, 2] = 0.1
    field = field_at(points) + np.random.default_rng(2).normal(scale=0.3e-6, size=points.shape)
    prior = HarmonicPrior()
    h = prior.choose_hyperparameters(points, field)
    model = prior.build(points, field, h)
    above = np.random.default_rng(3).uniform([0.2, 0.2, 0.2], [1.8, 1.3, 0.2], size=(300, 3))
    error = model.infer(model.observe(points, field)).evaluate(above).field - field_at(above)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.03 * np.sqrt(field_at(above).var(axis=0).sum())


def test_numbers_follow_the_units():
    points, field = room(300)
    prior = HarmonicPrior()
    h = calibrated(prior, points, field, prior.choose_hyperparameters(points, field))
    points, field = points * 10, field * 1e3
    scaled = calibrated(prior, points, field, prior.choose_hyperparameters(points, field))
    np.testing.assert_allclose(
        [scaled.lengthscale, scaled.signal_sd, scaled.noise_sd, scaled.inflation],
        [10 * h.lengthscale, 1e3 * h.signal_sd, 1e3 * h.noise_sd, h.inflation],
        rtol=1e-6,
    )
