# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from magmatch.field.build import build_map
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.steps import register_once
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate


def test_a_walk_is_compared_with_every_sample_that_was_given():
    """A map leaves out what contradicts the rest; the walk's answer does not depend on one having been made."""
    pair, config = simulate("corridor", 0, SimulationConfig(n_samples=600)), RegistrationConfig(search="pairs")
    base, target = build_map(pair.base), pair.target
    fewer = build_map(target.subset(np.arange(0, len(target), 2)))
    alone, mapped = (register_once(base, used, target, config, 0, Clock())[2] for used in (target, fewer))
    assert alone.evidence["log_odds"] == mapped.evidence["log_odds"] > 0
