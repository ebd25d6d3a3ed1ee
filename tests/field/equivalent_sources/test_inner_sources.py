# SPDX-License-Identifier: BSD-3-Clause
"""Claims about charges among the samples: they stand for what is there, and only for that."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from dipoles import dipoles
from magmatch.field.domain import Box
from magmatch.field.equivalent_sources.inner_sources import find_inner_sources, hole_charges
from magmatch.field.equivalent_sources.shell import lay_shell
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors.harmonic import HarmonicPrior

BOX, NOISE = np.array([1.6, 1.2, 0.8]), 0.4e-6
H = Hyperparameters(lengthscale=0.4, signal_sd=12e-6, noise_sd=NOISE, spacing=0.2)
PRIOR = HarmonicPrior(max_sources=600)


def field_at(points, strength):
    """Earth's field, dipoles half a metre below a box, and two of a strength among the samples."""
    rng = np.random.default_rng(0)
    sources = [(rng.uniform([0, 0, -0.6], [1.6, 1.2, -0.5]), 1e-6 * rng.normal(size=3)) for _ in range(8)]
    sources += [(BOX / 2 + [s, 0, 0], strength * 1e-6 * np.array([1.0, s, 0.5])) for s in (-0.08, 0.08)]
    return np.array([18e-6, 2e-6, -44e-6]) + dipoles(points, *zip(*sources, strict=True))


def around_hole(n, seed):
    """Points of the box that keep 30 cm away from its middle."""
    points = np.random.default_rng(seed).uniform(0, BOX, size=(n, 3))
    return points[np.linalg.norm(points - BOX / 2, axis=1) > 0.3]


def room(strength, n=600):
    points = around_hole(n, 1)
    return points, field_at(points, strength) + np.random.default_rng(2).normal(scale=NOISE, size=points.shape)


@pytest.fixture(scope="module")
def furnished():
    points, field = room(strength=0.5)
    h = PRIOR.choose_hyperparameters(points, field)
    model = PRIOR.build(points, field, h)
    return model.infer(model.observe(points, field))


def test_what_stands_among_the_samples_is_followed_and_no_longer_counts_as_noise(furnished):
    assert furnished.hyperparameters.noise_sd < 1.3 * NOISE
    at = around_hole(600, 3)
    error = np.sqrt(((furnished.evaluate(at).field - field_at(at, 0.5)) ** 2).sum(axis=1))
    assert np.median(error) < 1.5 * NOISE


def test_the_map_knows_nothing_next_to_such_a_charge(furnished):
    charges = furnished.model.basis.inner.data
    assert not furnished.knows(charges).any()
    beside = charges[:3] + 0.01
    sd = np.sqrt(np.trace(furnished.covariance(beside), axis1=1, axis2=2) / 3)
    assert np.isfinite(furnished.evaluate(beside, 1).gradient).all()
    assert sd.min() > 0.5 * furnished.hyperparameters.signal_sd


def test_holes_of_chance_stay_empty():
    points = np.random.default_rng(1).uniform(0, BOX, size=(500, 3))
    field = field_at(points, 0.0) + np.random.default_rng(9).normal(scale=NOISE, size=points.shape)
    shell = lay_shell(points, 0.4, 0.2, 600)
    assert find_inner_sources(shell, points, field).filled(H) is shell


def test_along_a_path_and_in_a_plane_there_are_no_holes():
    s = np.linspace(0, 1, 500)
    path = np.stack([1.6 * s, 0.6 + 0.5 * np.sin(40 * s), 0.4 + 0.3 * np.cos(55 * s)], axis=1)
    plane = around_hole(600, 1) * [1, 1, 0.01]
    for points in (path, plane):
        assert len(hole_charges(lay_shell(points, 0.4, 0.2, 600), points)[0]) == 0


def test_a_declared_box_is_kept_free_of_charges_whatever_the_data_show():
    box = Box(np.zeros(3), BOX, RigidTransform.identity())
    assert HarmonicPrior(box, PRIOR.max_sources).build(*room(0.5), H).basis.inner is None
    assert PRIOR.build(*room(0.5), H).basis.inner is not None


def test_charges_in_a_hole_turn_with_it_and_keep_away_from_samples_and_layer():
    """Mirrored samples hold the mirrored hole; lattices lie alike from both ends."""
    points = around_hole(700, 8)
    flip = np.array([1.0, 1.0, -1.0])
    shell = lay_shell(points, 0.4, 0.2, 600)
    other = replace(shell, sources=shell.sources * flip)
    (found, group), (mirrored, _) = hole_charges(shell, points), hole_charges(other, points * flip)
    assert len(found) > 10
    assert cKDTree(found * flip).query(mirrored)[0].max() < 1e-9
    assert len(mirrored) == len(found)
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert cKDTree(points).query(found)[0].min() >= max(2.4 * np.median(nearest), 0.4 * 0.4) - 1e-12
    assert cKDTree(shell.sources).query(found)[0].min() > 0.5 * 0.4
    for k in np.unique(group):
        assert np.ptp(found[group == k], axis=0).max() <= max(2.4 * np.median(nearest), 0.4 * 0.4)
