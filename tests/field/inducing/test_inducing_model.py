# SPDX-License-Identifier: BSD-3-Clause
"""The published prior behind the common interface: equal to its oracles, bounded whatever it is given."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated
from magmatch.field.inducing.gaussian_grid import GaussianGrid, InducingGrid
from magmatch.field.inducing.inducing_model import InducingModel, dense_prior, gram_factor
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, DivergenceFreeKernel
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.field.priors.gaussian import DivergenceFreePrior
from magmatch.published.recursion import RecursiveField
from oracles.dense import DenseGP

laws = settings(deadline=None, max_examples=8)
H = Hyperparameters(lengthscale=0.7, signal_sd=12e-6, noise_sd=0.5e-6, spacing=0.6)
EARTH = np.array([18e-6, 2e-6, -44e-6])
CONSTANT_SD = 1e-4
PRIOR = DivergenceFreePrior()


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


def test_prior_is_registered_by_name():
    assert isinstance(PRIORS["divergence_free"], DivergenceFreePrior)
    assert PRIORS["divergence_free"].name == "divergence_free"


def test_information_is_the_sums_that_it_is_defined_by(model, samples):
    points, field = samples
    found, A = model.observe(points, field), model.features(points, 0)
    expected = A @ A.T
    np.testing.assert_allclose(np.tril(found.gram), np.tril(expected), atol=1e-10 * np.abs(expected).max())
    eta = A @ field.T.ravel() / H.noise_sd
    np.testing.assert_allclose(found.eta, eta, atol=1e-10 * np.abs(eta).max())


def test_batch_equals_the_published_recursion(model, posterior, samples):
    points, field = samples
    kernel = DivergenceFreeKernel(H.lengthscale, H.signal_sd)
    state = RecursiveField.start(kernel, model.basis.grid.nodes, H.noise_sd, CONSTANT_SD, jitter=1e-9)
    for rows in np.array_split(np.random.default_rng(0).permutation(len(points)), 7):
        state = state.update(points[rows], field[rows])
    here, recursive = posterior.evaluate(queries(), 2), state.mean(queries(), 2)
    np.testing.assert_allclose(here.field, recursive.field, rtol=1e-8)
    np.testing.assert_allclose(here.gradient, recursive.gradient, atol=1e-8 * np.abs(here.gradient).max())
    np.testing.assert_allclose(here.second, recursive.second, atol=1e-8 * np.abs(here.second).max())
    # DTC differs by the constant's variance, which the recursion's white weights hold too.
    prior = H.signal_sd**2 * np.eye(3)
    np.testing.assert_allclose(
        posterior.covariance(queries()), state.dtc_covariance(queries()), atol=1e-8 * prior[0, 0]
    )


@laws
@given(st.integers(0, 1000), st.integers(1, 299))
def test_samples_left_out_are_as_if_never_seen_in_any_order(model, samples, seed, cut):
    points, field = samples
    order = np.random.default_rng(seed).permutation(300)
    kept, out = order[:cut], order[cut:]
    rest = model.observe(points[order], field[order]) - model.observe(points[out], field[out])
    expected = model.infer(model.observe(points[kept], field[kept])).evaluate(queries()).field
    np.testing.assert_allclose(model.infer(rest).evaluate(queries()).field, expected, rtol=1e-7)


def model_at_nodes(seed=0):
    """A model whose inducing points are the samples."""
    full = np.stack(np.meshgrid(range(4), range(4), range(3), indexing="ij"), axis=-1).reshape(-1, 3)
    index = full[np.sort(np.random.default_rng(seed).permutation(48)[:30])]
    grid = InducingGrid(np.array([0.2, 0.1, 0.0]), 0.5, index - index.min(axis=0))
    basis = GaussianGrid(grid, H.lengthscale, DIVERGENCE_FREE)
    kernel = DivergenceFreeKernel(H.lengthscale, 1.0)
    factor = dense_prior(basis.gram(), H, CONSTANT_SD, jitter=1e-11)
    return InducingModel(H, basis, kernel, CONSTANT_SD, factor, cKDTree(grid.nodes), H.lengthscale)


def test_inducing_points_at_all_samples_give_the_exact_model(dipoles_at):
    model = model_at_nodes()
    points = model.basis.grid.nodes
    field = dipoles_at(points)
    posterior = model.infer(model.observe(points, field))
    exact = DenseGP.fit(DivergenceFreeKernel(H.lengthscale, H.signal_sd), points, field, H.noise_sd, CONSTANT_SD)
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


def test_close_inducing_points_come_close_to_the_exact_model(samples):
    points, field = samples
    exact = DenseGP.fit(DivergenceFreeKernel(H.lengthscale, H.signal_sd), points, field, H.noise_sd, CONSTANT_SD)
    model = PRIOR.build(points, field, replace(H, spacing=0.6 * H.lengthscale))
    posterior = model.infer(model.observe(points, field))
    error = posterior.evaluate(queries()).field - exact.mean(queries()).field
    # A tenth of the noise; wider nodes lose more (docs/tried.md).
    assert np.sqrt((error**2).mean()) < 0.1 * H.noise_sd


def test_derivatives_are_finite_differences(posterior):
    h = 1e-4
    exact = posterior.evaluate(queries(), 2)
    for k, e in enumerate(np.eye(3)):
        up, down = posterior.evaluate(queries() + h * e, 1), posterior.evaluate(queries() - h * e, 1)
        # Central differences err by (h / l)^2.
        first, second = (up.field - down.field) / (2 * h), (up.gradient - down.gradient) / (2 * h)
        np.testing.assert_allclose(exact.gradient[..., k], first, atol=1e-7 * np.abs(exact.gradient).max())
        np.testing.assert_allclose(exact.second[..., k], second, atol=1e-7 * np.abs(exact.second).max())


def test_field_has_no_divergence_even_in_draws(posterior):
    for w in [None, *posterior.draw_weights(3, np.random.default_rng(0))]:
        gradient = posterior.evaluate(queries(), 1, w).gradient
        divergence = np.trace(gradient, axis1=1, axis2=2)
        np.testing.assert_allclose(divergence, 0, atol=1e-9 * np.abs(gradient).max())


@pytest.mark.parametrize("unit", [1e-3, 1e6])
def test_the_unit_of_the_field_does_not_matter(posterior, samples, unit):
    points, field = samples
    h = replace(H, signal_sd=H.signal_sd * unit, noise_sd=H.noise_sd * unit)
    prior = DivergenceFreePrior(constant_sd=CONSTANT_SD * unit)
    model = prior.build(points, field * unit, h)
    other = model.infer(model.observe(points, field * unit))
    np.testing.assert_allclose(other.weights / unit, posterior.weights, atol=1e-7 * np.abs(posterior.weights).max())
    np.testing.assert_allclose(
        other.covariance(queries()) / unit**2, posterior.covariance(queries()), atol=1e-9 * H.signal_sd**2
    )


def test_the_origin_does_not_matter(posterior, samples):
    points, field = samples
    shift = np.array([300.0, -200.0, 50.0])
    model = PRIOR.build(points + shift, field, H)
    moved = model.infer(model.observe(points + shift, field)).evaluate(queries() + shift).field
    # Coordinates of 300 m are rounded to 6e-14 m, and the fit magnifies it.
    np.testing.assert_allclose(moved, posterior.evaluate(queries()).field, rtol=1e-7)


def test_far_away_the_covariance_is_the_priors_and_the_mean_the_constant(posterior):
    far = np.array([[60.0, 0.0, 0.0]])
    np.testing.assert_allclose(posterior.evaluate(far).field[0], posterior.weights[-3:])
    kernel = DivergenceFreeKernel(H.lengthscale, H.signal_sd)
    covariance = posterior.covariance(far, 1)[0]
    np.testing.assert_allclose(covariance[3:, 3:], kernel.at_one_point(1)[3:, 3:], rtol=1e-9)
    beyond_prior = covariance[:3, :3] - kernel.at_one_point()
    assert 0 < np.trace(beyond_prior) / 3 < (0.5 * CONSTANT_SD) ** 2


def test_covariance_of_the_field_is_part_of_that_with_gradients(posterior):
    np.testing.assert_allclose(
        posterior.covariance(queries(), 1)[:, :3, :3], posterior.covariance(queries()), atol=1e-9 * H.signal_sd**2
    )


def test_draws_scatter_as_the_posterior_says(posterior):
    w = posterior.draw_weights(2000, np.random.default_rng(1))
    x = queries(3)
    values = np.stack([posterior.evaluate(x, weights=one).field for one in w])
    # Inside the samples little is left of what the inducing points cannot follow: compare with the SoR part.
    A = posterior.model.features(x, 0)
    half = np.linalg.solve(posterior.factor, A)
    sor = H.noise_sd**2 * np.einsum("kan,kbn->nab", *[half.reshape(len(A), 3, 3)] * 2)
    np.testing.assert_allclose(values.mean(axis=0), posterior.evaluate(x).field, atol=0.1 * H.noise_sd)
    sampled = np.stack([np.cov(values[:, i].T) for i in range(3)])
    # Variances from 2,000 draws are known to 3 %.
    np.testing.assert_allclose(sampled, sor, atol=0.15 * np.abs(sor).max())


def test_spread_fits_the_errors(dipoles_at, room):
    points, field = room(seed=2, n=600)
    h = calibrated(PRIOR, points, field, PRIOR.choose_hyperparameters(points, field))
    model = PRIOR.build(points, field, h)
    posterior = model.infer(model.observe(points, field))
    x = np.random.default_rng(5).uniform(0.1, [1.9, 1.4, 0.7], size=(300, 3))
    error = posterior.evaluate(x).field - dipoles_at(x, 2)
    squared = np.einsum("na,nab,nb->n", error, np.linalg.inv(posterior.covariance(x)), error)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1.5e-6
    assert 0.1 < squared.mean() / 3 < 4


def test_knows_reaches_a_part_of_the_lengthscale_beyond_samples(posterior):
    near, away = np.array([[1.0, 0.7, 0.4], [-0.3, 0.7, 0.4]]), np.array([[-1.0, 0.7, 0.4], [50.0, 0.0, 0.0]])
    assert posterior.knows(near).all()
    assert not posterior.knows(away).any()


@pytest.mark.parametrize("length", [0.4, 0.8])
def test_hyperparameters_of_a_drawn_field_are_found(length):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, [2.5, 2.0, 0.6], size=(400, 3))
    K = DivergenceFreeKernel(length, 10e-6).covariance(points, points)
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
    prior = DivergenceFreePrior(most=100)
    h = prior.choose_hyperparameters(points, field)
    assert "100 inducing points cannot cover the survey more finely" in caplog.text
    model = prior.build(points, field, h)
    assert len(model.basis.grid) <= 100
    assert model.hyperparameters == h
    assert h.spacing <= 0.75 * h.lengthscale


@pytest.mark.parametrize("spacing", [1e-6, 0.05, 0.3, 5.0, 1e4])
def test_any_spacing_gives_a_bounded_model(samples, spacing):
    model = PRIOR.build(*samples, replace(H, spacing=spacing))
    assert 8 <= len(model.basis.grid) <= 1200
    field = model.infer(model.observe(*samples)).evaluate(queries()).field
    assert np.abs(field).max() < 2 * np.abs(samples[1]).max()


def test_a_field_that_the_nodes_cannot_follow_is_warned_about(samples, caplog):
    PRIOR.build(*samples, replace(H, spacing=2.0))
    assert "the field between them is lost" in caplog.text


def test_questions_from_absurdly_far_away_get_the_prior(posterior):
    x = np.array([[1e7, 1e7, 1e7], [-1e200, 0.0, 0.0]])
    np.testing.assert_allclose(posterior.evaluate(x, 2).field, np.tile(posterior.weights[-3:], (2, 1)))
    assert not posterior.knows(x).any()
    assert np.isfinite(posterior.covariance(x, 1)).all()


def test_a_map_of_this_prior_is_saved_and_loaded_bit_for_bit(samples, tmp_path):
    survey = Survey(*samples)
    config = FieldConfig(prior="divergence_free")
    built = build_map(survey, config)
    built.save(tmp_path / "room.map")
    loaded = FieldMap.load(tmp_path / "room.map")
    assert loaded.hyperparameters == built.hyperparameters
    np.testing.assert_array_equal(loaded.evaluate(queries(), 2).second, built.evaluate(queries(), 2).second)
    gridded = built.on_grid(built.grid_over(0.4), 1)
    np.testing.assert_allclose(gridded.values.field, built.evaluate(gridded.grid.points()).field, atol=1e-13)
    assert np.isfinite(gridded.variance).all()


GEOMETRIES = {
    "line": np.array([1.0, 0.0, 0.0]),
    "plane": np.array([1.0, 1.0, 0.0]),
    "volume": np.ones(3),
    "point": np.zeros(3),
}


@pytest.mark.parametrize("shape", GEOMETRIES)
@pytest.mark.parametrize("fill", ["dipoles", "constant", "zero"])
@pytest.mark.parametrize("n", [4, 40])
def test_singular_surveys_give_bounded_answers(shape, fill, n, dipoles_at):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1.5, size=(n, 3)) * GEOMETRIES[shape]
    points[1] = points[0]
    field = {"dipoles": dipoles_at(points), "constant": np.tile(EARTH, (n, 1)), "zero": np.zeros((n, 3))}[fill]
    posterior = posterior_of(points, field)
    x = np.concatenate([points, points + 0.3])
    values = posterior.evaluate(x, 2)
    assert np.isfinite(values.second).all()
    assert np.abs(values.field).max() <= 3 * np.abs(field).max() + 1e-9
    assert np.linalg.eigvalsh(posterior.covariance(x, 1)[:, :3, :3]).min() > -1e-12 * CONSTANT_SD**2


def posterior_of(points, field):
    model = PRIOR.build(points, field, PRIOR.choose_hyperparameters(points, field))
    return model.infer(model.observe(points, field))


def test_a_turned_survey_gives_the_turned_field(room):
    points, field = room(n=200)
    T = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([0.0, 0.0, np.pi / 2]))
    turned = posterior_of(T.apply(points), field @ T.rotation.as_matrix().T)
    expected = posterior_of(points, field).evaluate(queries()).rotated(T).field
    # Rounding moves the lengthscale's search by nothing, and the fit by what the jitter lets through.
    np.testing.assert_allclose(turned.evaluate(T.apply(queries())).field, expected, rtol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_are_refused(bad, room):
    points, field = room(n=20)
    field[3, 1] = bad
    with pytest.raises(SurveyError, match="finite"):
        PRIOR.choose_hyperparameters(points, field)
    with pytest.raises(SurveyError, match="finite"):
        PRIOR.build(points, field, H)


def test_too_few_samples_are_refused(room):
    with pytest.raises(SurveyError, match="at least 4 samples to fit a field, got 3"):
        PRIOR.choose_hyperparameters(*room(n=3))


def test_subtracting_more_than_was_added_is_refused_with_the_eigenvalue(model, samples):
    points, field = samples
    less = model.observe(points[:10], field[:10]) - model.observe(points, field)
    with pytest.raises(ValueError, match=r"posterior precision is not positive definite .* eigenvalue -"):
        model.infer(less)


def test_a_covariance_that_cannot_be_factored_is_refused_with_its_eigenvalue_in_units_of_the_variance():
    with pytest.raises(ValueError, match=r"smallest eigenvalue -1\.0e\+00 of the variance"):
        gram_factor(1e-12 * np.array([[1.0, 2.0], [2.0, 1.0]]), 1e-9)
