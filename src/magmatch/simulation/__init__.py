# SPDX-License-Identifier: BSD-3-Clause
"""Surveys of known places with exact ground truth."""

from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.corruption import Corruption, corrupt, draw_corruption
from magmatch.simulation.scenarios import SCENARIOS
from magmatch.simulation.scene import SimulatedPair

__all__ = ["SCENARIOS", "Corruption", "SimulatedPair", "SimulationConfig", "corrupt", "draw_corruption"]
