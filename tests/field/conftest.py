# SPDX-License-Identifier: BSD-3-Clause
"""Samples of a field that has no source where it is measured."""

import numpy as np
import pytest

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig

EARTH = np.array([18e-6, 2e-6, -44e-6])


def field_of_dipoles(points, seed=0, box=(2.0, 1.5, 0.8)):
    """Field of a few dipoles outside a box, about 15 uT, on top of the Earth's."""
    rng = np.random.default_rng(seed)
    box = np.asarray(box)
    sources = rng.uniform(-1.2, box + 1.2, size=(40, 3))
    is_outside = np.linalg.norm(np.maximum(np.maximum(-sources, sources - box), 0), axis=1) > 0.5
    return EARTH + dipoles(points, sources[is_outside], 4e-6 * rng.normal(size=(is_outside.sum(), 3)))


def samples_of_dipoles(seed=0, n=300, noise_sd=0.5e-6, box=(2.0, 1.5, 0.8)):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, box, size=(n, 3))
    return points, field_of_dipoles(points, seed, box) + rng.normal(scale=noise_sd, size=(n, 3))


@pytest.fixture(scope="session")
def dipoles_at():
    """Function of points: a field with sources around them only."""
    return field_of_dipoles


@pytest.fixture(scope="session")
def room():
    """Function that gives positions in a box and a noisy field there."""
    return samples_of_dipoles


@pytest.fixture(scope="session")
def small_map():
    """A map of few samples by given numbers, made at once."""
    numbers = FieldConfig(prior="spline", lengthscale=0.6, signal_sd=8e-6, noise_sd=5e-7, spacing=0.3)
    return build_map(Survey(*samples_of_dipoles(n=200, box=(1.5, 1.0, 0.4))), numbers)
