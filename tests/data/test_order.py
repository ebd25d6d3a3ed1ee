# SPDX-License-Identifier: BSD-3-Clause
"""Path lengths are given of paths only."""

import numpy as np
import pytest

from magmatch.data.describe import describe
from magmatch.data.survey import Survey, has_order


def survey(p, **more):
    return Survey(p, np.full(p.shape, 3e-5) + 1e-6 * np.random.default_rng(0).normal(size=p.shape), **more)


@pytest.fixture
def lanes():
    """A lawn-mower path of 20 lanes."""
    x = np.linspace(0, 5, 60)
    rows = [np.column_stack([x if k % 2 == 0 else x[::-1], np.full(60, 0.25 * k), np.zeros(60)]) for k in range(20)]
    return np.concatenate(rows)


def test_a_path_without_times_has_a_length(lanes):
    assert has_order(survey(lanes))
    assert describe(survey(lanes))["path_length"] == pytest.approx(20 * 5 + 19 * 0.25)


def test_a_loop_walked_again_on_its_own_track_is_a_path():
    s = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    loop = 4 * np.column_stack([np.cos(s), np.sin(s), 0 * s])
    assert has_order(survey(np.concatenate([loop, 1.002 * loop, 0.998 * loop])))


def test_the_way_from_one_log_to_the_next_is_no_part_of_a_maps_path(lanes):
    logs = [survey(lanes[:60]), survey(lanes[600:660])]
    assert describe(logs[0].merged(logs[1]), parts=logs)["path_length"] == pytest.approx(5 + 5)
    logs.append(survey(np.random.default_rng(1).permutation(lanes)))
    facts = describe(logs[0].merged(*logs[1:]), parts=logs)
    assert (facts["ordered"], facts["path_length"], facts["median_step"]) == (False, None, None)


def test_samples_in_no_order_have_none(lanes):
    shuffled = survey(np.random.default_rng(1).permutation(lanes))
    assert not has_order(shuffled)
    facts = describe(shuffled)
    assert (facts["ordered"], facts["path_length"], facts["median_step"]) == (False, None, None)


@pytest.mark.parametrize("size", [(6, 5, 1.4), (20, 0.1, 0.1), (30, 20, 0)])
@pytest.mark.parametrize("n", [20, 2000])
def test_points_at_random_in_a_volume_a_line_or_an_area_are_no_path(size, n):
    assert not has_order(survey(np.random.default_rng(n).uniform(0, 1, (n, 3)) * size))
