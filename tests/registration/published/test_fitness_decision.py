# SPDX-License-Identifier: BSD-3-Clause
import pytest

from magmatch.registration.published.fitness_decision import FitnessConfig, decide_by_fitness
from magmatch.registration.result import Status


@pytest.mark.parametrize(
    ("fitness", "overlap", "status"),
    [
        (None, 0.0, Status.UNINFORMATIVE),
        (0.01, 0.01, Status.NO_OVERLAP),
        (0.9, 0.9, Status.INCONSISTENT),
        (0.01, 0.9, Status.ACCEPTED),
    ],
)
def test_published_rule_looks_at_fitness_alone(fitness, overlap, status):
    assert decide_by_fitness(fitness, overlap, FitnessConfig()).status is status
