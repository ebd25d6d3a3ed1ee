# SPDX-License-Identifier: BSD-3-Clause
"""The noun of this room: two simulated surveys and the exact truth between them."""

from dataclasses import dataclass, field

from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.simulation.config import SimulationConfig


@dataclass(frozen=True, eq=False, slots=True)
class SimulatedPair:
    """Two surveys with known relation."""

    scenario: str  # name of the scenario
    seed: int  # seed it was made from
    base: Survey  # each in its own frame
    target: Survey
    T_base_target: RigidTransform  # exact ground truth (also where nothing can be found)
    # Whether a correct program accepts a registration here: False where the places differ or the field has no
    # structure
    accept: bool
    config: SimulationConfig = field(default_factory=SimulationConfig)  # settings it was made with
