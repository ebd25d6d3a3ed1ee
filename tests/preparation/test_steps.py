# SPDX-License-Identifier: BSD-3-Clause
"""Each step alone: disturbances, resampling, Earth's field, report."""

import json
from datetime import date

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.earth_field import Place, earth_field, earth_step
from magmatch.preparation.preparation_report import PreparationReport, StepReport
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.preparation.survey_steps import resample_by_distance, steps_of

MUNICH = Place(48.14, 11.58, 520, date(2024, 5, 1))


def test_words_that_yaml_reads_as_true_and_false_need_no_quotes():
    said = yaml.safe_load("{recalibration: off, time_offset: {mode: on}, disturbances: {spikes: off}}")
    config = PreparationConfig.model_validate(said)
    assert (config.recalibration, config.time_offset.mode, config.disturbances.spikes) == ("off", "on", "off")
    with pytest.raises(ValueError, match="flag"):
        PreparationConfig.model_validate({"disturbances": {"spikes": True}})


@pytest.fixture
def rng():
    return np.random.default_rng(2)


@pytest.fixture
def walk(rng):
    """Two minutes to and fro on a line with a stop, at 20 Hz."""
    x = np.concatenate([np.linspace(0, 3, 1000), np.full(400, 3.0), np.linspace(3, 0, 1000)])
    positions = np.column_stack([x, 0.1 * np.sin(x), 0 * x])
    field = np.column_stack([20e-6 + 5e-6 * np.sin(2 * x), 3e-6 * x, -40e-6 + 0 * x])
    orientations = Rotation.from_euler("z", 0.3 * x[:, None])
    noise = 0.2e-6 * rng.standard_normal(field.shape)
    return Survey(positions, field + noise, 0.05 * np.arange(len(x)), orientations)


def test_each_step_is_the_mean_or_the_median_of_its_own_samples(walk):
    number = steps_of(walk.positions, 0.3)
    mean, median = (resample_by_distance(walk, 0.3, average) for average in ("mean", "median"))
    for k in range(number[-1] + 1):
        some = walk.subset(np.flatnonzero(number == k))
        np.testing.assert_allclose(mean.field[k], some.field.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(median.field[k], np.median(some.field, axis=0), rtol=1e-12)
        np.testing.assert_allclose(median.positions[k], some.positions.mean(axis=0), atol=1e-12)
        assert (mean.orientations[k].inv() * some.orientations.mean()).magnitude() < 1e-9


def test_a_step_begins_where_the_last_one_is_as_far_away_as_it_is_long():
    x = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0.3], [0, 0.4, 0.31], [0, 0, 0], [0, 0, 0.1]])
    assert steps_of(x, 0.5).tolist() == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize("latitude", [90, -90])
def test_earth_field_at_a_pole_is_that_beside_it(latitude):
    pytest.importorskip("ppigrf")
    at, beside = (earth_field(Place(part * latitude, 30, 0, date(2024, 5, 1))) for part in (1, 1 - 1e-6))
    np.testing.assert_allclose(at, beside, atol=1e-9)


def test_a_wrong_unit_and_a_tilted_frame_are_said():
    pytest.importorskip("ppigrf")
    field = np.tile(earth_field(MUNICH), (20, 1))
    assert "off by 10^-2 (--field-unit)" in earth_step(0.01 * field, MUNICH).words
    assert "z is not up" in earth_step(field[:, [2, 1, 0]], MUNICH).words
    assert "hard iron" in earth_step(2 * field, MUNICH).words


@pytest.mark.parametrize("wrong", [(91, 0, 0, 2024), (0, 400, 0, 2024), (0, 0, 1e7, 2024), (0, 0, 0, 1850)])
def test_impossible_places_are_refused(wrong):
    with pytest.raises(ConfigurationError, match="expected a"):
        Place(*wrong[:3], date(wrong[3], 1, 1))


@pytest.mark.parametrize(
    ("key", "value"),
    [("sensor", None), ("sensor", {"matrix": [[1]], "shift": [0]}), ("n_samples", [3]), ("steps", [4])],
)
def test_a_value_of_a_report_that_cannot_be_is_named(key, value, tmp_path):
    report = PreparationReport("log.csv", (10, 10), (), {}, SensorCorrection(), (), "0")
    (tmp_path / "r.json").write_text(json.dumps(report.to_dict() | {key: value}))
    with pytest.raises(DataFormatError, match=f"key '{key}"):
        PreparationReport.load(tmp_path / "r.json")


def test_an_inclination_and_a_magnitude_are_plausible_on_both_sides_of_each_limit():
    pytest.importorskip("ppigrf")
    model = earth_field(MUNICH)
    for ratio, is_plausible in ((0.59, False), (0.61, True), (1.59, True), (1.61, False)):
        assert earth_step(np.tile(ratio * model, (5, 1)), MUNICH).figures["is_plausible"] == is_plausible
    north = Rotation.from_euler("z", np.arctan2(model[1], model[0])).apply([1.0, 0, 0])
    about = np.cross(north, [0, 0, 1.0])
    for bend, is_plausible in ((34.0, True), (36.0, False)):
        tilted = Rotation.from_rotvec(np.radians(bend) * about).apply(model)
        check = earth_step(np.tile(tilted, (5, 1)), MUNICH)
        assert (check.outcome == "unchanged") == is_plausible
        dip = np.degrees(np.arcsin(-tilted[2] / np.linalg.norm(tilted)))
        assert check.figures["inclination_deg"] == pytest.approx(dip)
        assert check.figures["magnitude"] == pytest.approx(check.figures["expected_magnitude"])


@pytest.mark.parametrize(
    ("outcome", "before", "after", "shown"),
    [
        ("applied", 6.561, 0.3771, "6.56 -> 0.377 uT"),
        ("applied", 9.7531, 9.7489, "9.753 -> 9.749 uT"),
        ("applied", 9.75, 9.75, "9.75 uT, as before"),
        ("unchanged", 9.75, 9.75, "9.75 -> 9.75 uT"),
        ("applied", 2499.0, 2498.0, "2499 -> 2498 samples"),
        ("flagged", 9.75, None, "9.75 uT"),
    ],
)
def test_what_was_applied_is_shown_in_digits_that_differ_or_said_to_change_nothing(outcome, before, after, shown):
    step = StepReport("soft iron", outcome, "found", before, after, shown.split()[-1] if "samples" in shown else "uT")
    report = PreparationReport("log", (1, 1), (step,), {}, SensorCorrection(), (), "1")
    assert report.table() == f"soft iron  {outcome}  {shown}  found"
