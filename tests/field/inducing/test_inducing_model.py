# SPDX-License-Identifier: BSD-3-Clause
"""The published prior behind the common interface: equal to its oracles, bounded whatever it is given."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.gaussian_grid import GaussianGrid, InducingGrid
from magmatch.field.inducing.inducing_model import InducingModel, dense_prior
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel
from magmatch.field.priors import PRIORS
from oracles.dense import DenseGP

H = Hyperparameters(lengthscale=0.7, signal_sd=12e-6, noise_sd=0.5e-6, spacing=0.6)
EARTH = np.array([18e-6, 2e-6, -44e-6])
CONSTANT_SD = 1e-4
PRIOR = PRIORS["divergence_free"]


@pytest.fixture(scope="module")
def samples(room):
    return room()


@pytest.fixture(scope="module")
def model(samples):
    return PRIOR.build(*samples, H)


@pytest.fixture(scope="module")
def posterior(model, samples):
    return model.infer(model.observe(*samples))


def queries(n=12):
    return np.random.default_rng(9).uniform(0.1, [1.9, 1.4, 0.7], size=(n, 3))


def model_at_nodes(seed=0):
    """A model whose inducing points are the samples."""
    full = np.stack(np.meshgrid(range(4), range(4), range(3), indexing="ij"), axis=-1).reshape(-1, 3)
    index = full[np.sort(np.random.default_rng(seed).permutation(48)[:30])]
    grid = InducingGrid(np.array([0.2, 0.1, 0.0]), 0.5, index - index.min(axis=0))
    basis = GaussianGrid(grid, H.lengthscale, DIVERGENCE_FREE)
    kernel = Kernel(DIVERGENCE_FREE, H.lengthscale, 1.0)
    factor = dense_prior(basis.gram(), H, CONSTANT_SD, jitter=1e-11)
    return InducingModel(H, basis, kernel, CONSTANT_SD, factor, cKDTree(grid.nodes), H.lengthscale)


def test_inducing_points_at_all_samples_give_the_exact_model(dipoles_at):
    model = model_at_nodes()
    points = model.basis.grid.nodes
    field = dipoles_at(points)
    posterior = model.infer(model.observe(points, field))
    exact = DenseGP.fit(Kernel(DIVERGENCE_FREE, H.lengthscale, H.signal_sd), points, field, H.noise_sd, CONSTANT_SD)
    x = np.concatenate([queries(), queries() * 4])
    sparse, dense = posterior.evaluate(x, 2), exact.mean(x, 2)
    for part in ("field", "gradient", "second"):
        expected = getattr(dense, part)
        np.testing.assert_allclose(getattr(sparse, part), expected, atol=1e-6 * np.abs(expected).max())
    for order in (0, 1):
        expected = exact.covariance(x, order)
        scale = np.sqrt(np.einsum("aa->a", exact.kernel.at_one_point(order)))
        error = np.abs(posterior.covariance(x, order) - expected) / np.outer(scale, scale)
        assert error.max() < 1e-6


def test_knows_reaches_a_part_of_the_lengthscale_beyond_samples(posterior):
    near, away = np.array([[1.0, 0.7, 0.4], [-0.3, 0.7, 0.4]]), np.array([[-1.0, 0.7, 0.4], [50.0, 0.0, 0.0]])
    assert posterior.knows(near).all()
    assert not posterior.knows(away).any()


@pytest.mark.parametrize("length", [0.4, 0.8])
def test_hyperparameters_of_a_drawn_field_are_found(length):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, [2.5, 2.0, 0.6], size=(400, 3))
    K = Kernel(DIVERGENCE_FREE, length, 10e-6).covariance(points, points)
    factor = np.linalg.cholesky(K + 1e-9 * K[0, 0] * np.eye(len(K)))
    field = EARTH + (factor @ rng.normal(size=1200)).reshape(3, -1).T + rng.normal(scale=0.5e-6, size=(400, 3))
    h = PRIOR.choose_hyperparameters(points, field)
    assert h.lengthscale == pytest.approx(length, rel=0.2)
    assert h.noise_sd == pytest.approx(0.5e-6, rel=0.3)
    assert h.signal_sd == pytest.approx(10e-6, rel=0.6)
    assert h == PRIOR.choose_hyperparameters(points, field)


def test_a_few_spikes_hardly_change_the_hyperparameters(room):
    points, field = room(n=500)
    clean = PRIOR.choose_hyperparameters(points, field)
    spiked = field.copy()
    spiked[::60] += 500e-6
    h = PRIOR.choose_hyperparameters(points, spiked)
    assert h.lengthscale == pytest.approx(clean.lengthscale, rel=0.25)
    assert h.noise_sd == pytest.approx(clean.noise_sd, rel=0.5)


def test_hyperparameters_follow_the_units_of_length_and_field(room):
    points, field = room(n=200)
    # Weak enough for the constant field's prior, which has a unit of its own, to be as good as flat.
    field = field * 1e-3
    h, scaled = PRIOR.choose_hyperparameters(points, field), PRIOR.choose_hyperparameters(points * 10, field * 10)
    np.testing.assert_allclose(
        [scaled.lengthscale, scaled.spacing, scaled.signal_sd, scaled.noise_sd],
        [10 * h.lengthscale, 10 * h.spacing, 10 * h.signal_sd, 10 * h.noise_sd],
        rtol=1e-4,
    )


def test_wide_surveys_get_the_finest_nodes_the_cap_allows(caplog, room):
    points, field = room(seed=1, n=400, box=(12.0, 9.0, 1.0))
    prior = InducingPrior("divergence_free", DIVERGENCE_FREE, DIVERGENCE_FREE, 100)
    h = prior.choose_hyperparameters(points, field)
    assert "100 inducing points cannot cover the survey more finely" in caplog.text
    model = prior.build(points, field, h)
    assert len(model.basis.grid) <= 100
    assert model.hyperparameters == h
    assert h.spacing <= 0.75 * h.lengthscale


def test_a_field_that_the_nodes_cannot_follow_is_warned_about(samples, caplog):
    PRIOR.build(*samples, replace(H, spacing=2.0))
    assert "the field between them is lost" in caplog.text


def test_subtracting_more_than_was_added_is_refused_with_the_eigenvalue(model, samples):
    points, field = samples
    less = model.observe(points[:10], field[:10]) - model.observe(points, field)
    with pytest.raises(ValueError, match=r"posterior precision is not positive definite .* eigenvalue -"):
        model.infer(less)
