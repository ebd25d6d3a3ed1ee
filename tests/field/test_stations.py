# SPDX-License-Identifier: BSD-3-Clause
"""Surveys by station, in regular lanes and of quiet fields: what a surveyor brings is mapped as it is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dipoles import dipoles
from magmatch import Survey, build_map
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.field.folds import has_path_order
from magmatch.field.linear_model import is_refit
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.subset import choose_part

EARTH = np.array([18e-6, 0.0, -45e-6])


def field_of(points, places, moments):
    """Field of dipoles (A m^2) and of the Earth, T."""
    return EARTH + dipoles(points, places, 1e-7 * moments)


@pytest.fixture(scope="module")
def stations():
    """Stations 0.6 m apart, above sources 0.8 m and more below."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(0, 5, 0.6), np.arange(0, 4.1, 0.6))
    places = rng.uniform([-1, -1, -1.2], [6, 5, 0.2], (30, 3))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 1.0)])
    return points, field_of(points, places, 8 * rng.normal(size=(30, 3)))


def test_more_readings_at_each_station_make_no_worse_map(stations):
    """They are no path, though most steps from one reading to the next are none."""
    points, truth = stations
    rng = np.random.default_rng(6)

    def rms(n):
        where = np.repeat(points, n, axis=0)
        read = np.repeat(truth, n, axis=0) + 4e-7 * rng.normal(size=where.shape)
        assert not has_path_order(where)
        return float(np.sqrt(np.mean((build_map(Survey(where, read), SPLINE).evaluate(points).field - truth) ** 2)))

    assert rms(10) < max(rms(1), 4e-7)


def test_where_somebody_stood_no_path_is_lost_and_a_walk_far_away_is_no_step_of_a_path():
    walk = np.column_stack([np.linspace(0, 20, 200), np.zeros((200, 2))])
    assert has_path_order(np.concatenate([walk[:100], np.repeat(walk[100:101], 900, axis=0), walk[100:]]))
    assert has_path_order(np.concatenate([walk, walk + np.array([500.0, 0, 0])]))


def test_a_spike_is_left_out_however_long_somebody_stood():
    """A figure of eight, walked twice: each place has witnesses of another pass."""
    s = np.linspace(0, 4 * np.pi, 900)
    walk = np.column_stack([4 * np.sin(s), 2 * np.sin(2 * s), np.zeros(len(s))])
    points = np.concatenate([walk[:100], np.repeat(walk[100:101], 2500, axis=0), walk[100:]])
    rng = np.random.default_rng(10)
    field = field_of(points, rng.uniform([-5, -3, -3], [5, 3, -2], (20, 3)), 60 * rng.normal(size=(20, 3)))
    field = field + 2e-7 * rng.normal(size=field.shape)
    spikes = [2800, 3100]
    field[spikes] += [2e-5, 0, 0]
    kept = build_map(Survey(points, field), SPLINE).survey.positions
    assert len(points) - len(kept) >= 2
    assert not (kept[:, None] == points[spikes]).all(axis=2).any()


def test_rounding_chooses_neither_samples_nor_numbers_of_regular_lanes():
    x, y = np.meshgrid(np.arange(0, 5, 0.1), np.arange(0, 4.1, 0.4))
    x[1::2] = x[1::2, ::-1]
    points = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    points -= points.mean(axis=0)
    rng = np.random.default_rng(7)
    field = field_of(points, rng.uniform([-3, -3, -2], [3, 3, -0.8], (20, 3)), 20 * rng.normal(size=(20, 3)))
    field = field + 4e-7 * rng.normal(size=field.shape)
    turn = Rotation.random(random_state=8)
    rounded = turn.apply(turn.apply(points), inverse=True)
    assert 0 < np.abs(rounded - points).max() < 1e-14
    np.testing.assert_array_equal(choose_part(rounded, 300, 3), choose_part(points, 300, 3))
    one, other = (choose_spline_hyperparameters(p, field) for p in (points, rounded))
    assert one.lengthscale == pytest.approx(other.lengthscale, rel=1e-6)
    assert one.noise_sd == pytest.approx(other.noise_sd, rel=1e-3)


@pytest.mark.parametrize(("share", "is_rounding"), [(1e-10, True), (1e-6, False)])
def test_rounding_of_a_quiet_field_is_no_other_field(stations, share, is_rounding):
    """48 uT with 1 nT of noise: what rounding changes is a share of the whole."""
    points, field = stations
    config = FieldConfig(prior="spline", lengthscale=1.0, signal_sd=1e-6, noise_sd=1e-9, spacing=0.5)
    made = build_map(Survey(points, field), config)
    samples = made.survey.transformed(made.T_map_model.inv())
    assert is_refit(made.posterior, made.posterior.weights * (1 + share), samples.positions) == is_rounding
