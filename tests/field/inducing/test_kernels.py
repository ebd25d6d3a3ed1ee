# SPDX-License-Identifier: BSD-3-Clause
"""The divergence-free kernel is what was published, obeys its law, and differentiates as it should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel

laws = settings(deadline=None, max_examples=20)
seeds = st.integers(0, 10_000)
lengthscales = st.floats(0.1, 10.0)
EYE = np.eye(3)


def blocks(kernel, points, others, order=0):
    """Covariance as (rows, n, 3, m)."""
    return kernel.covariance(points, others, order).reshape(-1, len(points), 3, len(others))


def printed(d, sf, length):
    """The kernel as the paper prints it."""
    r2 = d @ d / length**2
    return sf**2 / length**2 * np.exp(-r2 / 2) * (np.outer(d, d) / length**2 + (2 - r2) * EYE)


@laws
@given(seeds, lengthscales)
def test_kernel_is_the_printed_formula(seed, length):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(4, 3)) * length, rng.normal(size=(5, 3)) * length
    kernel = Kernel(DIVERGENCE_FREE, length, 17e-6)
    K, sf = blocks(kernel, x, y), 17e-6 * length / np.sqrt(2)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(K[:, i, :, j], printed(x[i] - y[j], sf, length), rtol=1e-9, atol=1e-24)


def test_prior_of_field_and_gradient_is_that_of_finite_differences():
    length, h = 0.7, 1e-3
    kernel = Kernel(DIVERGENCE_FREE, length, 2.0)
    offsets = np.concatenate([np.zeros((1, 3)), h * EYE, -h * EYE])
    K = kernel.covariance(offsets, offsets).reshape(3, 7, 3, 7)
    stencil = np.zeros((4, 7))
    stencil[0, 0] = 1
    stencil[range(1, 4), range(1, 4)], stencil[range(1, 4), range(4, 7)] = 1 / (2 * h), -1 / (2 * h)
    joint = np.einsum("pi,aibj,qj->apbq", stencil, K, stencil)
    rows = [(a, 0) for a in range(3)] + [(a, 1 + b) for a in range(3) for b in range(3)]
    differences = np.array([[joint[a, p, b, q] for b, q in rows] for a, p in rows])
    # Central differences err by (h / l)^2.
    np.testing.assert_allclose(kernel.at_one_point(1), differences, atol=1e-4)
    np.testing.assert_allclose(kernel.at_one_point(0), 4.0 * EYE, rtol=1e-14)


@pytest.mark.parametrize(("length", "sd"), [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (np.inf, 1.0)])
def test_impossible_kernel_is_refused(length, sd):
    with pytest.raises(ValueError, match="expected positive lengthscale and signal_sd"):
        Kernel(DIVERGENCE_FREE, length, sd)
