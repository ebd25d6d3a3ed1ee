# SPDX-License-Identifier: BSD-3-Clause
"""Readings that turn with their sensor are told from those of a place; quickly, and in any frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from magmatch.data.survey import Survey
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from magmatch.preparation.sensor_model import EXPECTED_SD
from magmatch.preparation.sensor_trace import MIN_EVIDENCE, offset_evidence
from oracles.dense_matrix import to_dense

HARD_IRON_SD = EXPECTED_SD["hard_iron"]


def evidence(survey):
    return offset_evidence(survey, choose_spline_hyperparameters(survey.positions, survey.field))


@pytest.mark.parametrize("carrier", ["hand_held", "robot"])
def test_a_raw_log_shows_its_sensor_and_a_clean_one_does_not(carrier, request):
    clean, raw, _ = request.getfixturevalue(carrier)
    assert evidence(clean) < 0
    assert evidence(raw) > 2 * MIN_EVIDENCE


def test_offset_along_an_axis_that_never_turns_is_not_shown(robot):
    # It is one more constant field of the place.
    clean = robot[0]
    h = choose_spline_hyperparameters(clean.positions, clean.field)
    vertical = np.array([0.0, 0.0, 30e-6])
    there = replace(clean, field=clean.field + clean.orientations.apply(np.tile(vertical, (len(clean), 1))))
    assert offset_evidence(there, h) < MIN_EVIDENCE


def test_without_orientations_nothing_is_told(hand_held):
    raw = replace(hand_held[1], orientations=None)
    assert offset_evidence(raw, Hyperparameters(0.5, 1e-5, 1e-6, 0.25)) == -np.inf


@pytest.mark.parametrize("size", [0.0, 1e-6])
def test_the_evidence_is_that_of_the_dense_gaussian_with_an_offset_along_its_best_told_direction(size):
    """Where the noise stated explains what is left; the offset's prior deviation is that of its settings."""
    rng, h = np.random.default_rng(5), Hyperparameters(0.6, 3e-6, 1e-6, 0.4, 100.0, reach=1.0)
    attitudes = Rotation.random(40, random_state=rng)
    x, offset = rng.uniform(0, 1, (40, 3)), attitudes.apply([size, -size, 0.5 * size])
    b = np.array([18e-6, 2e-6, -44e-6]) + 2e-6 * np.sin(2 * x) + offset + 0.5e-6 * rng.normal(size=x.shape)
    survey = Survey(x, b, orientations=attitudes)
    found = offset_evidence(survey, h)
    part = survey.transformed(survey.principal_frame().inv())
    model = SplineModel.over(part.positions, h)
    nothing = model.infer(model.observe(np.zeros((0, 3)), np.zeros((0, 3))))
    rows = [nothing.evaluate(part.positions, 0, w).field.ravel() for w in np.eye(len(nothing.weights))]
    prior = np.linalg.inv(to_dense(model.prior_precision(), model.cells)) * h.noise_sd**2
    K = np.transpose(rows) @ prior @ rows + h.noise_sd**2 * np.eye(120)
    columns = part.orientations.as_matrix().reshape(120, 3)
    directions = np.linalg.eigh(columns.T @ np.linalg.solve(K, columns))[1].T
    y = 1e6 * part.field.ravel()
    gains = [
        multivariate_normal(None, 1e12 * (K + HARD_IRON_SD**2 * np.outer(columns @ v, columns @ v))).logpdf(y)
        - multivariate_normal(None, 1e12 * K).logpdf(y)
        for v in directions
    ]
    assert found == pytest.approx(max(gains), rel=1e-3, abs=1e-2)
