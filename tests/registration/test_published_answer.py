# SPDX-License-Identifier: BSD-3-Clause
"""The published decision: both sides of each limit, and the best consensus said as it was found."""

import pytest

from magmatch.published.fitness import Fitness, FitnessConfig
from magmatch.registration.published_answer import verdict_of
from magmatch.registration.result import Status

CONFIG = FitnessConfig()


@pytest.mark.parametrize(
    ("fitness", "overlap", "status"),
    [
        (None, 0.0, Status.UNINFORMATIVE),
        (0.01, 0.0499, Status.NO_OVERLAP),
        (0.1001, 0.9, Status.INCONSISTENT),
        (0.1, 0.05, Status.ACCEPTED),
    ],
)
def test_published_rule_looks_at_fitness_and_overlap_alone(fitness, overlap, status):
    check = None if fitness is None else Fitness(fitness, overlap)
    assert verdict_of(check, CONFIG).status is status
