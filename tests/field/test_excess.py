# SPDX-License-Identifier: BSD-3-Clause
"""A map holds nothing that its samples make impossible, or says so."""

import logging

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.field import choose_prior as choice
from magmatch.field.build import build_map
from magmatch.field.choose_prior import PriorCandidate
from magmatch.field.config import FieldConfig
from magmatch.field.excess import excess
from magmatch.field.priors import PRIORS

# Huge charges far away: the prior that a rough field along lines asked for.
ABSURD = FieldConfig(
    prior="harmonic", lengthscale=3.0, spacing=1.5, signal_sd=5e-3, noise_sd=1e-6, leave_out_outliers=False
)


def lines(n=20):
    """Three corridors and three across, with a field that no sources outside of them make."""
    along = np.linspace(0, 10, n)
    x = np.concatenate(
        [np.stack(pair, axis=1) for at in (0, 3, 6) for pair in ((along, at + 0 * along), (at + 0 * along, along))]
    )
    x = np.column_stack([x, np.zeros(len(x))])
    waves = np.stack([np.sin(1.5 * x[:, 1] + x[:, 0]), np.sin(1.5 * x[:, 0]), np.cos(1.5 * (x[:, 0] - x[:, 1]))], 1)
    noise = np.random.default_rng(0).normal(scale=1e-6, size=x.shape)
    return Survey(x, 8e-6 * waves + [18e-6, 2e-6, -44e-6] + noise)


@pytest.fixture(scope="module")
def absurd():
    """A map by that prior, and what was said as it was made."""
    said, handler = [], logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    logging.getLogger("magmatch").addHandler(handler)
    built = build_map(lines(), ABSURD)
    logging.getLogger("magmatch").removeHandler(handler)
    return built, " ".join(said)


def test_a_map_that_varies_far_more_beside_its_samples_than_at_them_says_so(absurd, caplog):
    built, said = absurd
    assert "beside samples that vary by" in said
    assert "use another prior" in said
    built.with_surveys(lines(7))
    assert "use another prior" in caplog.text


@pytest.mark.parametrize("prior", sorted(PRIORS))
def test_with_numbers_of_its_own_no_prior_makes_more_of_a_survey_than_it_shows(prior, caplog):
    survey = lines(15)
    with caplog.at_level(logging.WARNING):
        built = build_map(survey, FieldConfig(prior=prior))
    assert excess(built, survey) == ""
    assert "use another prior" not in caplog.text


def test_auto_names_and_leaves_out_a_prior_whose_field_the_samples_make_impossible(absurd, caplog):
    survey = lines()
    points, field = survey.positions, survey.field
    model = absurd[0].posterior.model
    spline = PriorCandidate("spline", model.hyperparameters, np.zeros(40))
    scatter = 0.01 * np.tile([-1.0, 1.0], 20)
    taken = PriorCandidate("harmonic", model.hyperparameters, scatter - 1, (model, model.observe(points, field)))
    assert choice.best([spline, taken]) is taken
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert choice.best_possible([spline, taken], survey) is spline
    assert "prior harmonic is out of the choice" in caplog.text


def test_on_a_line_nothing_is_known_beyond_the_reach_of_its_samples():
    x = np.column_stack([np.linspace(0, 12, 60), np.zeros((60, 2))])
    field = 1e-6 * np.stack([18 + 6 * np.sin(x[:, 0]), 2 + 5 * np.cos(x[:, 0]), -44 + 7 * np.sin(0.7 * x[:, 0])], 1)
    survey = Survey(x, field + np.random.default_rng(1).normal(scale=3e-7, size=x.shape))
    for prior in PRIORS:
        built = build_map(survey, FieldConfig(prior=prior))
        beside = np.array([0, 2.5 * built.hyperparameters.lengthscale, 0])
        assert not built.knows(x + beside).any(), prior
        assert excess(built, survey) == "", prior
