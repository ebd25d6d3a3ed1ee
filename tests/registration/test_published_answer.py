# SPDX-License-Identifier: BSD-3-Clause
"""The published decision: both sides of each limit, and the best consensus said as it was found."""

import numpy as np
import pytest

from magmatch.geometry import random_transform
from magmatch.published.fitness import Fitness, FitnessConfig
from magmatch.registration.published_answer import state_check, verdict_of
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


def test_the_answer_is_the_best_consensus_or_a_refusal_that_shows_all():
    rng = np.random.default_rng(0)
    poses = random_transform(rng), random_transform(rng)
    accepted = state_check(poses, Fitness(0.05, 0.7), CONFIG)
    assert accepted.T_base_target is poses[0]
    assert (accepted.fitness, accepted.overlap, accepted.alternatives) == (0.05, 0.7, ())
    refused = state_check(poses, Fitness(0.5, 0.7), CONFIG)
    assert refused.T_base_target is None
    assert [a.T_base_target for a in refused.alternatives] == list(poses)
    nothing = state_check((), None, CONFIG)
    assert (nothing.status, nothing.overlap) == (Status.UNINFORMATIVE, 0.0)
