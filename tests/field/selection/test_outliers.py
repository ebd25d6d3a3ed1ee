# SPDX-License-Identifier: BSD-3-Clause
"""What contradicts its neighbours is left out and said; what is merely steep stays."""

import numpy as np
import pytest

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field.build import build_map, map_samples
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.field.selection.outliers import find_outliers, reweighted_residuals
from magmatch.field.tiles.region_model import TiledModel
from magmatch.field.tiles.tiles import Tiling

UT = 1e-6
SETTINGS = FieldConfig(prior="spline", lengthscale=0.5, noise_sd=0.3 * UT, spacing=0.25)
SOURCES = np.array([[0.5, 0.4, -0.6], [1.6, 1.2, -0.7], [0.2, 1.9, 1.4]])


def field_at(x):
    return UT * np.array([18.0, 3.0, -45.0]) + dipoles(x, SOURCES, 4 * UT * np.eye(3))


def room(n=1200, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, [2, 2, 0.6], (n, 3))
    return x, field_at(x) + 0.3 * UT * rng.normal(size=x.shape), rng


def rmse(field_map, q):
    return np.sqrt(((field_map.evaluate(q).field - field_at(q)) ** 2).sum(axis=1).mean())


def test_spikes_are_left_out_and_told(caplog):
    x, b, rng = room()
    hit = rng.choice(len(x), 12, replace=False)
    spiked = b.copy()
    spiked[hit] += 30 * UT * rng.normal(size=(12, 3))
    q = rng.uniform(0.1, [1.9, 1.9, 0.5], (400, 3))
    clean = build_map(Survey(x, b), SETTINGS)
    with caplog.at_level("WARNING"):
        robust = build_map(Survey(x, spiked, name="office"), SETTINGS)
    trusting = build_map(Survey(x, spiked), SETTINGS.model_copy(update={"leave_out_outliers": False}))
    assert "office" in caplog.text
    assert "contradict" in caplog.text
    assert len(trusting.survey) == 1200
    left_out = 1200 - len(robust.survey)
    assert 9 <= left_out <= 14
    assert rmse(robust, q) < 1.2 * rmse(clean, q)
    assert rmse(trusting, q) > 2 * rmse(clean, q)


def test_numbers_are_chosen_again_only_where_what_is_left_out_shaped_them():
    x, b, rng = room(600, seed=4)
    config = FieldConfig(prior="spline", spacing=0.25)
    everything = config.model_copy(update={"leave_out_outliers": False})
    faint, strong = b.copy(), b.copy()
    faint[7] += np.array([4, 0, 0]) * UT
    hit = rng.choice(len(x), 8, replace=False)
    strong[hit] += 40 * UT * rng.normal(size=(8, 3))
    for spiked, is_kept in ((faint, True), (strong, False)):
        cleaned = build_map(Survey(x, spiked), config)
        assert len(cleaned.survey) < len(x)
        kept = cleaned.hyperparameters == build_map(Survey(x, spiked), everything).hyperparameters
        assert kept == is_kept


def test_clean_rooms_and_steep_fields_keep_all_but_a_thousandth():
    x, b, _ = room(seed=1)
    assert len(build_map(Survey(x, b), SETTINGS).survey) >= 0.999 * len(x)
    near = np.array([[1.0, 1.0, -0.15]])
    r = x - near
    steep = b + 0.05 * UT * r / np.linalg.norm(r, axis=1, keepdims=True) ** 4
    assert len(build_map(Survey(x, steep), SETTINGS).survey) >= 0.995 * len(x)


def test_a_lift_that_passed_on_one_lap_of_four_is_left_out():
    rng = np.random.default_rng(2)
    turn = np.linspace(0, 8 * np.pi, 2400)
    x = np.c_[1 + 0.8 * np.cos(turn), 1 + 0.8 * np.sin(turn), 0.3 + 0.02 * rng.normal(size=2400)]
    b = field_at(x) + 0.3 * UT * rng.normal(size=x.shape)
    passing = slice(1000, 1060)
    b[passing] += np.array([12, -8, 15]) * UT
    kept = build_map(Survey(x, b, times=np.arange(2400.0)), SETTINGS).survey
    missing = np.setdiff1d(np.arange(2400.0), kept.times)
    assert len(missing) >= 50
    assert np.mean((missing >= 1000) & (missing < 1060)) > 0.95


def test_samples_of_one_pass_deny_nothing_and_those_of_another_do():
    """One walk past a bump that is narrower than the splines, alone and beside a second one that never met it."""
    rng = np.random.default_rng(8)
    s = np.linspace(1, 3, 400)
    lane = np.c_[s, np.full(400, 1.0), np.full(400, 0.3)]
    bump = 25 * UT * np.exp(-(((s - 2) / 0.03) ** 2))[:, None] * [0.6, 0.0, 0.8]
    beside = lane[::-1] + np.array([0.0, 0.05, 0.0])
    for x, b, n_out in (
        (lane, field_at(lane) + bump, 0),
        (np.r_[lane, beside], np.r_[field_at(lane) + bump, field_at(beside)], 5),
    ):
        noisy = b + 0.1 * UT * rng.normal(size=b.shape)
        model = PRIORS["spline"].build(x, noisy, Hyperparameters(0.5, 8 * UT, 0.3 * UT, 0.25, 100.0))
        is_out = find_outliers(Survey(x, noisy), model.infer(model.observe(x, noisy)))
        assert n_out <= is_out.sum() <= 4 * n_out


def test_a_survey_that_contradicts_itself_everywhere_is_kept_with_a_word(caplog):
    x, b, rng = room(seed=3)
    hit = rng.random(len(x)) < 0.2
    b[hit] += 30 * UT * rng.normal(size=(hit.sum(), 3))
    with caplog.at_level("WARNING"):
        assert len(build_map(Survey(x, b), SETTINGS).survey) == len(x)
    assert "too many" in caplog.text


@pytest.mark.parametrize("n", [5, 40])
def test_few_samples_are_all_kept(n):
    x, b, _ = room(n, seed=5)
    b[0] += 1e-3
    assert len(map_samples((Survey(x, b),), SETTINGS).survey) == n


@pytest.mark.parametrize("name", ["spline", "divergence_free", "curl_free", "harmonic"])
def test_counting_samples_less_is_as_good_as_fitting_again(name):
    x, b, rng = room(150, seed=6)
    h = Hyperparameters(0.8, 8 * UT, 0.5 * UT, 0.4, 100.0 if name == "spline" else 0.0, inflation=1.7, reach=2.0)
    model = PRIORS[name].build(x, b, h)
    rows, weights = rng.choice(150, 20, replace=False), np.ones(150)
    weights[rows] = rng.uniform(0.01, 1.0, 20) if name == "spline" else 0.0
    everything = model.observe(x, b)
    fit = model.infer(everything)
    # The basis of a spline can be told weights; those of others, which samples to leave out.
    less = model.observe(x, b, weights) if name == "spline" else everything - model.observe(x[rows], b[rows])
    again = b - model.infer(less).evaluate(x).field
    residual = b - fit.evaluate(x).field
    assert np.abs(again[rows] - residual[rows]).max() > 0.05 * UT
    left = reweighted_residuals(fit.influence(x[rows]), residual[rows], weights[rows])
    assert np.abs(left - again[rows]).max() < 1e-8 * np.abs(again[rows]).max()


def test_in_tiles_counting_samples_less_is_nearly_as_good_as_fitting_again():
    rng = np.random.default_rng(7)
    x = rng.uniform(0, [4, 2, 0.4], (900, 3))
    b = field_at(x) + 0.3 * UT * rng.normal(size=x.shape)
    hit = rng.choice(900, 20, replace=False)
    b[hit] += 20 * UT * rng.normal(size=(20, 3))
    h = Hyperparameters(0.6, 8 * UT, 0.5 * UT, 0.2, 100.0)
    model = TiledModel.over(x, h, Tiling(0.2, margin=4, reach=2, core=8, blend=2))
    everything = model.observe(x, b)
    fit = model.infer(everything)
    before = b[hit] - fit.evaluate(x[hit]).field
    again = b[hit] - model.infer(everything - model.observe(x[hit], b[hit])).evaluate(x[hit]).field
    left = reweighted_residuals(fit.influence(x[hit]), before, np.zeros(20))
    assert len(model.tiles) > 3
    assert np.linalg.norm(left - again) < 0.05 * np.linalg.norm(again - before)
