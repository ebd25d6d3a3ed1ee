# SPDX-License-Identifier: BSD-3-Clause
"""What is left out, and what length a field has."""

import numpy as np
import pytest

from magmatch.field.held_out import (
    choose_part,
    has_path_order,
    path_segments,
    sample_distance,
    space_blocks,
    typical_length,
)
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.affordability import affordable_spacing

rng = np.random.default_rng(0)
CLOUD = rng.uniform(0, 3, (2000, 3))
WALK = np.c_[np.linspace(0, 20, 2000), np.sin(np.linspace(0, 9, 2000)), np.zeros(2000)]


@pytest.mark.parametrize("length", [0.3, 0.6, 1.0])
def test_typical_length_of_a_squared_exponential_potential_is_its_lengthscale(length):
    draw = np.random.default_rng(1)
    k = draw.normal(size=(400, 3)) / length
    phase = draw.uniform(0, 2 * np.pi, 400)
    field = 1e-6 * np.sin(CLOUD @ k.T + phase) @ k
    assert typical_length(CLOUD, field) == pytest.approx(length, rel=0.35)


def test_a_few_spikes_do_not_change_the_typical_length():
    field = 1e-6 * np.sin(3 * CLOUD)
    spiked = field.copy()
    spiked[::100] += 1e-4
    assert typical_length(CLOUD, spiked) == pytest.approx(typical_length(CLOUD, field), rel=0.3)


def test_typical_length_of_noise_is_that_of_the_region():
    noise = np.random.default_rng(2).normal(size=CLOUD.shape)
    assert typical_length(CLOUD, noise) == pytest.approx(np.linalg.norm(np.ptp(CLOUD, axis=0)) / 4)


def test_walks_have_path_order_and_clouds_do_not():
    assert has_path_order(WALK)
    assert not has_path_order(CLOUD)
    assert not has_path_order(WALK[rng.permutation(len(WALK))])


def test_segments_are_contiguous_and_of_the_length_asked_for():
    segment = path_segments(WALK, 1.0)
    assert np.all(np.isin(np.diff(segment), [0, 1]))
    along = np.linalg.norm(np.diff(WALK, axis=0), axis=1)
    lengths = np.bincount(segment[1:], weights=along)
    assert np.all(np.abs(lengths - 1.0) < 0.15)


def test_samples_of_one_block_lie_within_its_cube():
    block = space_blocks(CLOUD, 0.5, np.random.default_rng(0))
    for k in range(10):
        assert np.ptp(CLOUD[block == k], axis=0).max() <= 0.5


def test_part_has_about_the_samples_asked_for():
    part = choose_part(WALK, 600, 3)
    assert 300 <= part.sum() <= 600


def test_spacing_that_would_take_too_long_is_widened_with_a_word(caplog, monkeypatch):
    monkeypatch.setattr("magmatch.field.selection.affordability.MOST_OPERATIONS", (5e8, 1e5))
    x = rng.uniform(0, 30, (500, 3)) * [1, 1, 0.01]
    spacing = affordable_spacing(x, Hyperparameters(0.35, 1e-6, 1e-7, 0.1))
    assert spacing > 0.1
    assert "widened" in caplog.text


@pytest.mark.parametrize("n", [300, 3000])
def test_the_distance_of_samples_anywhere_is_the_side_of_the_cube_that_each_has(n):
    x = np.random.default_rng(0).uniform(0, 2.0, (n, 3))
    # At the rim neighbours are missing.
    assert sample_distance(x) == pytest.approx((8.0 / n) ** (1 / 3), rel=0.2)
    assert sample_distance(10 * x) == pytest.approx(10 * sample_distance(x))


def test_the_distance_of_samples_at_one_place_is_nothing():
    assert sample_distance(np.zeros((5, 3))) == 0
