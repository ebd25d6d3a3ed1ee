# SPDX-License-Identifier: BSD-3-Clause
"""Claims about honest spread: misfit widens the posterior, noise does not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from dipoles import dipoles
from magmatch.field.domain import Box
from magmatch.field.folds import divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated, misfit_inflation, widened
from magmatch.field.priors import PRIORS
from magmatch.field.priors.harmonic import HarmonicPrior

BOX, NOISE = np.array([1.6, 1.2, 0.8]), 0.5e-6
H = Hyperparameters(lengthscale=0.4, signal_sd=12e-6, noise_sd=2 * NOISE, spacing=0.2)
PRIOR = HarmonicPrior(max_sources=500)
# The kernels of the last two are of one kind.
QUICK_AND_SLOW = ["harmonic", "curl_free", pytest.param("divergence_free", marks=pytest.mark.slow)]
# Small magnets that samples come so near to that they leave no hole.
MAGNETS, NEAREST = np.array([[0.4, 0.4, 0.4], [1.1, 0.8, 0.3], [1.2, 0.3, 0.5]]), 0.06


def field_at(points, strength):
    """Earth's field, a dipole below a box, and magnets of a strength among the samples."""
    moments = np.outer([2e-6, *[strength * 1e-8] * len(MAGNETS)], [0.6, 0.0, 0.8])
    return np.array([18e-6, 2e-6, -44e-6]) + dipoles(points, [[0.8, 0.6, -0.6], *MAGNETS], moments)


def samples(n, seed):
    points = np.random.default_rng(seed).uniform(0, BOX, size=(n, 3))
    return points[np.linalg.norm(points[:, None] - MAGNETS, axis=2).min(axis=1) > NEAREST]


def survey(strength, n=700, seed=0):
    points = samples(n, seed)
    return points, field_at(points, strength) + np.random.default_rng(1).normal(scale=NOISE, size=points.shape)


def test_intervals_hold_where_magnets_among_the_samples_break_the_promise_of_the_prior():
    points, field = survey(3.0)
    # A box that is declared free of sources allows no charges at the magnets.
    box = Box(np.zeros(3), BOX, RigidTransform.identity())
    prior = HarmonicPrior(box, PRIOR.max_sources)
    h = calibrated(prior, points, field, prior.choose_hyperparameters(points, field))
    model = prior.build(points, field, h)
    posterior = model.infer(model.observe(points, field))
    at = samples(700, 5)
    size = np.abs(posterior.evaluate(at).field - field_at(at, 3.0))
    sd = np.sqrt(np.diagonal(posterior.covariance(at), axis1=1, axis2=2))
    assert h.inflation > 1.2
    assert np.mean(size < 1.96 * sd / h.inflation) < 0.9 < np.mean(size < 1.96 * sd) <= 0.99


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", QUICK_AND_SLOW)
def test_what_is_only_noise_widens_nothing(name, seed):
    points, field = survey(0.0, seed=seed)
    model = PRIORS[name].build(points, field, H)
    # Of two samples at one place each is the other's neighbour, not its own.
    twice = np.concatenate([points, points[:50]]), np.concatenate([field, field_at(points[:50], 0.0)])
    assert misfit_inflation(*twice, model.infer(model.observe(*twice))) == 1.0


@pytest.mark.parametrize("name", QUICK_AND_SLOW)
def test_a_model_that_is_too_sure_is_widened_until_it_covers_what_was_left_out(name):
    points, field = survey(0.0, n=300)
    folds, prior = divide(points, 0.5), PRIORS[name]

    def coverage(h):
        said = []
        for fold in folds.left_out:
            model = prior.build(points, field, h)
            posterior = model.infer(model.observe(points[~fold], field[~fold]))
            variance = np.diagonal(posterior.covariance(points[fold]), axis1=1, axis2=2) + h.noise_sd**2
            error = posterior.evaluate(points[fold]).field - field[fold]
            said.append(np.abs(error) < 1.96 * np.sqrt(variance))
        return np.concatenate(said).mean()

    def without(fold):
        model = prior.build(points, field, sure)
        return model.infer(model.observe(points[~fold], field[~fold]))

    sure = replace(H, noise_sd=0.05e-6)
    honest = widened(sure, points, field, folds, without)
    assert coverage(sure) < 0.8
    assert 0.93 < coverage(honest) < 0.97
    # The mean stays: noise and prior grew alike.
    assert honest.noise_sd / honest.prior_scale == pytest.approx(sure.noise_sd / sure.prior_scale)


def test_what_neighbours_on_a_path_share_may_be_their_poses_error_and_widens_nothing():
    """The same samples in the order of a walk and in none: only there a shared misfit counts."""
    s = np.linspace(0, 2 * np.pi, 400)
    walk = BOX * (0.5 + 0.45 * np.c_[np.sin(5 * s), np.sin(4 * s + 1), np.sin(7 * s + 2)])
    field = field_at(walk, 0.0) + np.random.default_rng(1).normal(scale=NOISE, size=walk.shape)
    field += 3 * NOISE * np.sin(40 * s)[:, None]
    shuffled = np.random.default_rng(2).permutation(400)
    on_path, in_none = (
        calibrated(PRIORS["curl_free"], walk[rows], field[rows], H).inflation for rows in (np.arange(400), shuffled)
    )
    assert on_path < in_none - 0.3
