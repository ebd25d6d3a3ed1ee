# SPDX-License-Identifier: BSD-3-Clause
"""A clean log of a room, and what raw logs make of it."""

import numpy as np
import pytest

from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.corruption import corrupt, draw_corruption
from magmatch.simulation.simulate import simulate

SMALL = SimulationConfig(n_samples=1200, room_size=(1.6, 1.6, 0.5))


def log_of(scenario, seed):
    """Clean survey, raw survey and the corruption between them."""
    clean = simulate(scenario, seed, SMALL).target
    rng = np.random.default_rng(seed)
    corruption = draw_corruption(rng)
    return clean, corrupt(clean, corruption, rng)[0], corruption


@pytest.fixture(scope="session")
def hand_held():
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    return log_of("office-hand-held", 0)


@pytest.fixture(scope="session")
def robot():
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    return log_of("office-robot", 0)
