"""Compiled rows of a walk's least squares are those of dense algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.walk_rows import add_alike, isolate, residual_rows, whiten, whiten_again
from magmatch.geometry import skew

NOISE = PathNoise(2e-7, 0.8, 1e-7, 1e-7, 1.5, 0.9, 0.01, 0.02, 3.0)
POSES, BINS = 3, 7


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_residuals_and_slopes_are_those_of_the_equations(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(POSES, rng=rng).as_matrix()
    y, b, field = (rng.standard_normal((POSES, BINS, 3)) for _ in range(3))
    gradient, strain = rng.standard_normal((POSES, BINS, 3, 3)), rng.uniform(1, 3, (POSES, BINS))
    known = rng.random((POSES, BINS)) < 0.7
    flat = field.reshape(-1, 3), gradient.reshape(-1, 3, 3)
    rows, slopes = residual_rows(R, y, b, flat, known, strain)
    Rt = np.swapaxes(R, 1, 2)[:, None]
    G = Rt @ gradient @ R[:, None] * known[..., None, None]
    share = (known / strain)[..., None]
    np.testing.assert_allclose(rows[..., 0], (b - field @ R) * share, atol=1e-12)
    np.testing.assert_allclose(rows[..., 1:4], (G @ skew(y) - skew(b)) * share[..., None], atol=1e-12)
    np.testing.assert_allclose(rows[..., 4:], -G * share[..., None], atol=1e-12)
    np.testing.assert_allclose(slopes, np.concatenate([skew(b), G], axis=3), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), n_columns=st.integers(1, 22))
def test_whitened_rows_have_the_products_of_the_covariance(seed, n_columns):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((POSES, BINS, 2 * BINS))
    C, rows = A @ np.swapaxes(A, 1, 2), rng.standard_normal((POSES, BINS, n_columns))
    L, white = np.linalg.cholesky(C), rows.copy()
    whiten(L, white)
    expected = np.swapaxes(rows, 1, 2) @ np.linalg.solve(C, rows)
    np.testing.assert_allclose(
        np.swapaxes(white, 1, 2) @ white, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max()
    )
    twice = np.ascontiguousarray(white[..., 0])
    whiten_again(L, twice)
    expected = np.linalg.solve(C, rows[..., :1])[..., 0]
    np.testing.assert_allclose(twice, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_what_components_have_alike_is_the_noise_s():
    rng = np.random.default_rng(0)
    d, sd = cdist(*[rng.standard_normal((BINS, 3))] * 2), rng.uniform(0, 1e-7, (POSES, BINS))
    for per_bin, expected in ((1, NOISE.isotropic(d, sd)), (3, np.kron(NOISE.isotropic(d, sd), np.eye(3)))):
        C = np.zeros((POSES, per_bin * BINS, per_bin * BINS))
        add_alike(C, *NOISE.alike(d), NOISE.map_factor * sd, NOISE.nugget_sd**2)
        np.testing.assert_allclose(C, expected, rtol=1e-12)


@pytest.mark.parametrize("per_bin", [1, 3])
def test_bins_that_are_cut_off_have_unit_variance_and_no_covariance(per_bin):
    rng = np.random.default_rng(1)
    A = rng.standard_normal((1, per_bin * BINS, per_bin * BINS))
    whole, known = A @ np.swapaxes(A, 1, 2), np.array([[True, False, True, True, False, True, True]])
    cut, kept = whole.copy(), np.repeat(known[0], per_bin)
    isolate(cut, known)
    np.testing.assert_array_equal(cut[0][np.ix_(kept, kept)], whole[0][np.ix_(kept, kept)])
    np.testing.assert_array_equal(cut[0][~kept], np.eye(per_bin * BINS)[~kept])
    np.testing.assert_array_equal(cut[0], cut[0].T)
