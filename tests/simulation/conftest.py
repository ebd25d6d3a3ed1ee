# SPDX-License-Identifier: BSD-3-Clause
"""Settings that leave only the truth."""

import numpy as np
import pytest

from magmatch.simulation.config import SimulationConfig


@pytest.fixture
def exact():
    return SimulationConfig(n_samples=200, noise_sd=0.0, pose_drift=0.0)


@pytest.fixture
def rng():
    return np.random.default_rng(5)
