# SPDX-License-Identifier: BSD-3-Clause
"""What is asked of a map before a search, on maps whose field is known exactly."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.features.invariants import rotation_invariants, traceless_symmetric
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.values import FieldValues
from magmatch.geometry import random_transform
from magmatch.registration.prepared.prepared_map import correlation_length_of, height_range, prepare


@pytest.fixture(scope="module")
def field_map(make_exact_pair):
    return make_exact_pair(2, RigidTransform.identity())[0].transformed(random_transform(np.random.default_rng(1)))


@pytest.fixture(scope="module")
def prepared(field_map):
    return prepare(field_map, 5, np.random.default_rng(0))


def smooth_field(length, sd, rng, n=4000):
    """Field and gradient of a random potential of squared-exponential covariance: at points far from each other."""
    waves, phase = rng.standard_normal((n, 200, 3)) / length, rng.uniform(0, 2 * np.pi, (n, 200))
    size = sd * length * np.sqrt(2 / 200)
    field = -size * np.einsum("nw,nwc->nc", np.sin(phase), waves)
    return FieldValues(field, -size * np.einsum("nw,nwa,nwb->nab", np.cos(phase), waves, waves))


def test_points_carry_the_maps_field_and_the_invariants_of_its_lawful_gradient(field_map, prepared):
    exact = field_map.posterior.evaluate(prepared.points, 1)
    np.testing.assert_array_equal(prepared.point_field, exact.field)
    np.testing.assert_allclose(prepared.point_gradient, traceless_symmetric(exact.gradient), atol=1e-18)
    expected = rotation_invariants(prepared.point_field, prepared.point_gradient)
    np.testing.assert_array_equal(prepared.invariants, expected)


def test_spreads_are_the_root_mean_square_of_what_draws_differ_by(prepared):
    # A draw of these maps is a constant field more: it bends no gradient.
    assert prepared.gradient_sd.max() < 1e-15
    differ = [
        rotation_invariants(prepared.point_field + w, prepared.point_gradient) - prepared.invariants
        for w in prepared.draws()
    ]
    np.testing.assert_allclose(prepared.invariant_sd, np.sqrt(np.mean(np.square(differ), axis=0)), rtol=1e-6)
    assert len(prepared.draws()) == 5
    spread = np.sqrt(np.mean([(w**2).mean() for w in prepared.draws()]))
    np.testing.assert_allclose(prepared.raster.sd[prepared.raster.sd >= 0], spread, rtol=1e-9)


@pytest.mark.parametrize("length", [0.4, 1.5])
def test_the_correlation_length_of_a_smooth_random_field_is_its_lengthscale(length):
    found = correlation_length_of(smooth_field(length, 5e-6, np.random.default_rng(3)))
    assert found == pytest.approx(length, rel=0.06)


def test_a_constant_field_changes_over_no_less_than_its_maps_functions():
    positions = np.random.default_rng(0).uniform(0, 1.5, (40, 3))
    field_map = build_map(Survey(positions, np.tile([2e-5, 0.0, -4e-5], (40, 1))), SPLINE)
    prepared = prepare(field_map, 2, np.random.default_rng(1))
    assert prepared.correlation_length >= field_map.hyperparameters.spacing
    # A raster a hundred times finer than that took minutes.
    assert prepared.raster.spacing >= field_map.hyperparameters.spacing / 16


def test_heights_are_those_of_the_surveys_frame_and_a_length_beyond(field_map, prepared):
    expected = np.ptp(field_map.survey.positions[:, 2]) + prepared.correlation_length
    assert height_range(prepared) == pytest.approx(expected)
