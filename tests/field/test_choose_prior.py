# SPDX-License-Identifier: BSD-3-Clause
"""Claims about ``prior="auto"``."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field import choose_prior as choice
from magmatch.field.build import build_map
from magmatch.field.choose_prior import PriorCandidate, choose_all_numbers, compare, compare_on_the_rest
from magmatch.field.config import FieldConfig
from magmatch.field.folds import divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.priors import DENSE_PRIORS, PRIORS
from magmatch.field.variogram import typical_length

BOX = np.array([1.6, 1.2, 0.6])
H = Hyperparameters(0.5, 10e-6, 0.5e-6, 0.35)


def field_at(points, *, inside):
    """Dipoles half a metre below, and magnets among the samples if asked for."""
    rng = np.random.default_rng(0)
    sources = [(rng.uniform([-0.3, -0.3, -0.7], [1.9, 1.5, -0.4]), 1.0) for _ in range(12)]
    if inside:
        sources += [(BOX * [0.3, 0.4, 0.5], 0.6), (BOX * [0.75, 0.6, 0.5], 0.6)]
    places, strengths = zip(*sources, strict=True)
    moments = 1e-6 * np.array(strengths)[:, None] * rng.normal(size=(len(sources), 3))
    return np.array([18e-6, 2e-6, -44e-6]) + dipoles(points, places, moments)


def room(*, inside, n=600, noise_sd=1e-6):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, BOX, size=(n, 3))
    for magnet in (BOX * [0.3, 0.4, 0.5], BOX * [0.75, 0.6, 0.5]):
        points = points[np.linalg.norm(points - magnet, axis=1) > 0.2]
    return points, field_at(points, inside=inside) + rng.normal(scale=noise_sd, size=points.shape)


def test_without_a_source_in_the_region_the_harmonic_prior_is_better_and_remembered(tmp_path, monkeypatch):
    # Few samples are no proof, so the proof asked for is waived here.
    monkeypatch.setattr(choice, "LEAST_T", 0.0)
    built = build_map(Survey(*room(inside=False, n=300, noise_sd=0.3e-6)), FieldConfig(prior="auto"))
    assert built.config.prior == "harmonic"
    errors = built.config.comparison
    assert set(errors) == set(PRIORS)
    assert errors["harmonic"] < errors["spline"]
    built.save(tmp_path / "map")
    again = FieldMap.load(tmp_path / "map")
    assert again.config == built.config
    at = BOX * [[0.5, 0.5, 0.5]]
    np.testing.assert_array_equal(again.evaluate(at).field, built.evaluate(at).field)


def test_too_few_samples_to_compare_take_the_spline():
    points, field = room(inside=False, n=30)
    built = build_map(Survey(points, field), FieldConfig(prior="auto"))
    assert built.config.prior == "spline"
    assert built.config.comparison == {}


def test_only_a_clear_margin_leaves_the_spline():
    rng = np.random.default_rng(0)
    spline = PriorCandidate("spline", H, rng.normal(size=40))
    better = PriorCandidate("harmonic", H, spline.log_errors - 0.2 + 0.1 * rng.normal(size=40))
    by_chance = PriorCandidate("curl_free", H, spline.log_errors - 0.3 + 1.0 * rng.normal(size=40))
    hardly = PriorCandidate("divergence_free", H, spline.log_errors - 0.001)
    assert choice.best([spline, hardly, by_chance]).name == "spline"
    assert choice.best([spline, better, hardly]).name == "harmonic"
    few = [PriorCandidate(name, H, spline.log_errors[:3] - k) for k, name in enumerate(("spline", "harmonic"))]
    assert choice.best(few).name == "spline"


@pytest.mark.slow
def test_what_loses_on_a_part_of_a_large_survey_is_not_laid_over_all_of_it(monkeypatch):
    t, (points, _) = np.linspace(0, 1, 2400)[:, None], room(inside=True, n=4)
    points = BOX * (0.5 + 0.45 * np.sin(2 * np.pi * t * [3.0, 17.0, 1.0]))
    noise = np.random.default_rng(2).normal(scale=1e-6, size=points.shape)
    survey, compared = Survey(points, field_at(points, inside=True) + noise), []
    monkeypatch.setattr(choice, "DENSE_PRIORS", {"harmonic": DENSE_PRIORS["harmonic"]})

    def watched(numbers, samples, *others):
        compared.append((list(numbers), len(samples)))
        return compare(numbers, samples, *others)

    monkeypatch.setattr(choice, "compare", watched)
    # The box is declared: else the charges may stand in the holes that the magnets leave among the samples.
    config = FieldConfig(prior="auto", domain=(0.0, 0.0, 0.0, *BOX))
    chosen, _ = choice.choose_prior(survey, config, RigidTransform.identity())
    assert chosen.prior == "spline"
    assert [names for names, _ in compared] == [["spline", "harmonic"]]
    assert compared[0][1] < len(survey) / 2
    assert chosen.comparison["harmonic"] > chosen.comparison["spline"]


def test_further_parts_are_asked_only_where_they_may_change_what_is_taken():
    scatter = np.tile([-1.0, 1.0], 20)
    spline = PriorCandidate("spline", H, np.zeros(40))
    clear = PriorCandidate("harmonic", H, 0.01 * scatter - 0.3)
    behind, ahead = (PriorCandidate("curl_free", H, 3.0 * scatter - gain) for gain in (0.2, 0.4))
    assert not choice.is_undecided([spline])
    assert not choice.is_undecided([spline, clear])
    assert not choice.is_undecided([spline, behind, clear])
    assert choice.is_undecided([spline, behind])
    assert choice.is_undecided([spline, ahead, clear])


def test_what_some_parts_leave_open_all_parts_decide(monkeypatch):
    points, field = room(inside=False, n=600)
    survey, folds = Survey(points, field), divide(points, typical_length(points, field))
    config = FieldConfig(prior="auto")
    known = choose_all_numbers(["spline", "harmonic"], survey, config, None, {})
    spline, harmonic = compare(known, survey, folds, None)
    assert harmonic.error < spline.error
    monkeypatch.setattr(choice, "DENSE_PRIORS", {"harmonic": DENSE_PRIORS["harmonic"]})
    # More proof than some parts can give, less than all of them do.
    gain = spline.log_errors - harmonic.log_errors
    monkeypatch.setattr(choice, "LEAST_T", 1.05 * gain.mean() / gain.std(ddof=1) * np.sqrt(len(gain)))
    assert choice.best([spline, harmonic]) is spline
    chosen, _ = choice.choose_prior(survey, config, RigidTransform.identity())
    assert chosen.prior == "harmonic"


def test_errors_of_parts_are_those_of_fits_that_never_saw_them():
    points, field = room(inside=False, n=500)
    survey, folds = Survey(points, field), divide(points, 0.6)
    (one,) = compared = compare({"spline": H}, survey, folds, None)
    (every,) = compare_on_the_rest(compared, survey, folds)
    model = PRIORS["spline"].build(points, field, H)

    def errors(left_out):
        for fold in left_out:
            fit = model.infer(model.observe(points[~fold], field[~fold]))
            square = ((fit.evaluate(points).field - field) ** 2).sum(axis=1)
            for part in np.unique(folds.part[fold]):
                here = fold & (folds.part == part)
                if here.sum() >= 3:
                    yield 0.5 * np.log(square[here].mean())

    np.testing.assert_allclose(one.log_errors, list(errors(folds.left_out)), atol=1e-6)
    np.testing.assert_allclose(every.log_errors, list(errors([*folds.left_out, *folds.rest])), atol=1e-6)
    assert one.error == np.exp(one.log_errors.mean())
