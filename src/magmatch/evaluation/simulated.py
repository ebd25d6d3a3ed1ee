# SPDX-License-Identifier: BSD-3-Clause
"""Pairs from the simulator: each seed draws a place, both paths, the frames and the noise anew."""

from dataclasses import dataclass, field
from pathlib import Path

from magmatch.evaluation.experiment import Pair
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate


@dataclass(frozen=True, slots=True)
class Simulated:
    """A named scenario with settings of its own.

    Attributes
    ----------
    scenario : str
    config : SimulationConfig
    """

    scenario: str
    config: SimulationConfig = field(default_factory=SimulationConfig)

    def __call__(self, seed: int, recordings: Path | None = None) -> Pair:  # noqa: ARG002  (fills the protocol)
        """Give the pair of a seed."""
        pair = simulate(self.scenario, seed, self.config)
        return Pair(pair.base, pair.target, pair.T_base_target, pair.accept)
