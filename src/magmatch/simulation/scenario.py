# SPDX-License-Identifier: BSD-3-Clause
"""The noun of this room: two simulated surveys and the exact truth between them."""

from dataclasses import dataclass, field

from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.simulation.config import SimulationConfig


@dataclass(frozen=True, eq=False, slots=True)
class SimulatedPair:
    """Two surveys with known relation.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    seed : int
        Seed it was made from.
    base, target : Survey
        Each in its own frame.
    T_base_target : RigidTransform
        Exact ground truth (also where nothing can be found).
    accept : bool
        Whether a correct program accepts a registration here: False where the places differ or the field
        has no structure.
    config : SimulationConfig
        Settings it was made with.
    """

    scenario: str
    seed: int
    base: Survey
    target: Survey
    T_base_target: RigidTransform
    accept: bool
    config: SimulationConfig = field(default_factory=SimulationConfig)
