# SPDX-License-Identifier: BSD-3-Clause
"""What is about to be written is held against what was read: corrections that no sensor needs are withdrawn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import SurveyError
from magmatch.preparation.calibrate_in_place import fit_ellipsoid
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.prepare import prepare
from magmatch.preparation.sensor_model import (
    MOST_SOFT_IRON,
    SOFT_IRON_BASIS,
    SensorCorrection,
    why_no_field,
    why_no_sensor,
)

UT = 1e-6
QUICK = PreparationConfig.model_validate(
    {"disturbances": {"spikes": "off", "moving_metal": "off"}, "n_samples": 600, "time_offset": {"mode": "off"}}
)


def log_of(change=lambda b: b, n=600):
    """A sensor that turns and tilts in a field that varies; its readings after some change."""
    rng, t = np.random.default_rng(1), 0.1 * np.arange(n)
    q = Rotation.from_euler("zyx", np.c_[0.7 * t, 0.4 * np.sin(0.9 * t), 0.4 * np.cos(0.7 * t)])
    x = np.c_[2 * np.sin(0.31 * t), 2 * np.sin(0.23 * t + 1), 1 + 0.1 * np.sin(0.2 * t)]
    field = np.array([18, 3, -44]) * UT + 3 * UT * np.sin(1.5 * x[:, [1, 0, 1]])
    readings = change(q.apply(field, inverse=True) + rng.normal(0, 0.2 * UT, (n, 3)))
    return Survey(x, q.apply(readings), t, q, name="log")


@pytest.mark.parametrize("part", range(5))
def test_soft_iron_is_bounded_away_from_what_makes_any_field_consistent(part):
    def of(size):
        return SensorCorrection(np.eye(3) + size * SOFT_IRON_BASIS[part])

    assert not why_no_sensor(of(0.9 * MOST_SOFT_IRON))
    assert "soft iron" in why_no_sensor(of(1.1 * MOST_SOFT_IRON))
    assert "soft iron" in why_no_sensor(of(-2 * MOST_SOFT_IRON))


def test_a_field_may_vary_less_after_a_correction_but_not_more():
    clean, biased = log_of(), log_of(lambda b: b + UT * np.array([8, -5, 3]))
    assert not why_no_field(biased.field, clean.field)
    assert "would vary more along the path" in why_no_field(clean.field, biased.field)
    assert "median magnitude would go from" in why_no_field(clean.field, 1e-3 * clean.field)
    assert not why_no_field(clean.field, clean.field)


def test_from_an_axis_that_is_stuck_nothing_is_estimated():
    survey = log_of(lambda b: np.where([False, True, False], -1.5 * UT, b))
    prepared, report = prepare(survey, QUICK)
    assert prepared is survey
    assert report["soft iron"].outcome == report["hard iron"].outcome == "unknown"
    assert report["soft iron"].words == "the sensor's y axis reads -1.5 uT in all 600 samples"


def test_a_soft_iron_beyond_the_bound_is_withdrawn_with_the_reason():
    survey = log_of(lambda b: b * [1, 0.4, 1])
    prepared, report = prepare(survey, QUICK)
    assert prepared is survey
    assert report["all corrections"].outcome == "unchanged"
    assert "withdrawn, none was applied: a soft iron of" in report["all corrections"].words


def test_a_sensor_that_does_not_move_is_told_so():
    rng, survey = np.random.default_rng(0), log_of()
    still = replace(
        survey,
        positions=rng.normal(1, 2e-3, (600, 3)),
        field=np.array([18, 3, -44]) * UT + rng.normal(0, 0.2 * UT, (600, 3)),
        orientations=Rotation.from_rotvec(rng.normal(0, 2e-3, (600, 3))),
    )
    prepared, report = prepare(still, QUICK)
    assert prepared is still
    assert "does not move" in report["hard iron"].words


def test_an_ellipsoid_of_a_sensor_with_a_dead_axis_is_refused():
    rng = np.random.default_rng(0)
    read = Rotation.random(300, rng=rng).apply([20 * UT, 0, -40 * UT]) + rng.normal(0, 0.2 * UT, (300, 3))
    with pytest.raises(SurveyError, match="y axis is stuck"):
        fit_ellipsoid(np.where([False, True, False], -1.5 * UT, read))
    with pytest.raises(SurveyError, match="soft iron of"):
        fit_ellipsoid(read * [1, 1, 0.5])


def test_thinning_takes_the_first_sample_of_each_step_and_channels_with_it():
    survey = log_of()
    config = QUICK.model_copy(update={"thin": 0.2})
    prepared, report = prepare(survey, config, channels={"motor": np.arange(600.0)})
    assert report["thinning"].before == 600 == report.n_samples[0]
    assert len(prepared) == report["thinning"].after == report.n_samples[1]
    assert np.isin(prepared.times, survey.times).all()
    steps = np.linalg.norm(np.diff(prepared.positions, axis=0), axis=1)
    assert steps.min() >= 0.2
