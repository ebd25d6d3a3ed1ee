# SPDX-License-Identifier: BSD-3-Clause
"""Evaluation one axis after the other equals the sum over all nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.inducing.gaussian_grid import GaussianGrid, lay_affordable_grid, lay_inducing_grid
from magmatch.field.inducing.kernels import DIVERGENCE_FREE

laws = settings(deadline=None, max_examples=15)


def flat(values):
    """Field, gradient and second derivatives side by side: (n, 39)."""
    n = len(values.field)
    return np.hstack([values.field, values.gradient.reshape(n, 9), values.second.reshape(n, 27)])


def assert_equal_to_rounding(values, expected):
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_array_less(np.abs(values - expected).max(axis=0), 1e-10 * scale + 1e-30)


def test_nodes_scattered_far_apart_are_summed_without_the_box_between():
    rng = np.random.default_rng(0)
    ends = np.array([[0.0, 0.0, 0.0], [900.0, 400.0, 100.0], [-5e4, 2e5, 3e4], [1e6, 0.0, 1.0]])
    points = (ends[:, None] + rng.uniform(size=(4, 5, 3))).reshape(-1, 3)
    basis = GaussianGrid(lay_inducing_grid(points, 0.5, 0.7), 0.7, DIVERGENCE_FREE)
    w = rng.normal(size=basis.n_weights)
    dense = (basis.design(points, 2) @ w).reshape(39, -1).T
    assert_equal_to_rounding(flat(basis.evaluate(points, w, 2, np.zeros(3))), dense)


@laws
@given(st.integers(0, 1000), st.floats(0.1, 2.0), st.floats(0.0, 1.5))
def test_inducing_points_surround_the_samples_and_lie_within_reach(seed, spacing, reach):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, size=(20, 3)) * rng.choice([0.0, 1.0, 3.0], size=3)
    nodes = lay_inducing_grid(points, spacing, reach).nodes
    distance = np.linalg.norm(nodes[:, None] - points, axis=2)
    assert distance.min(axis=1).max() <= max(reach, spacing * np.sqrt(3) / 2) * (1 + 1e-6)
    assert distance.min(axis=0).max() <= spacing * np.sqrt(3) / 2 * (1 + 1e-6)
    assert (nodes.min(axis=0) <= points.min(axis=0) + 1e-9).all()
    assert (nodes.max(axis=0) >= points.max(axis=0) - 1e-9).all()


@laws
@given(st.integers(0, 1000), st.floats(1e-3, 3.0), st.integers(60, 400))
def test_the_cap_on_inducing_points_holds(seed, spacing, cap):
    points = np.random.default_rng(seed).uniform(size=(50, 3)) * [30.0, 5.0, 1.0]
    grid = lay_affordable_grid(points, spacing, lambda h: max(0.3, h), cap)
    assert 8 <= len(grid) <= cap
    assert grid.spacing >= spacing


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, 1e-300])
def test_impossible_spacing_is_refused(spacing):
    with pytest.raises(ValueError, match="cannot lay inducing points"):
        lay_inducing_grid(np.array([[0.0, 0, 0], [1.0, 0, 0]]), spacing, 0.0)
