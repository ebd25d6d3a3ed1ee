# SPDX-License-Identifier: BSD-3-Clause
"""A scenario before anything is measured, the random streams it is drawn from, and the pair of surveys it becomes."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.brief import brief
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import Source, field_of
from magmatch.simulation.paths import SensorPath
from magmatch.typing import Points, Vector3, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """A scenario before anything is measured: all that is true."""

    base_sources: tuple[Source, ...]  # what stood in the world at either survey; the same unless something moved
    target_sources: tuple[Source, ...]
    base_path: SensorPath  # True sensor poses, world frame
    target_path: SensorPath
    T_base_world: RigidTransform  # take world coordinates to either survey's frame
    T_target_world: RigidTransform
    earth_field: Vector3  # (3,), T: world frame
    accept: bool = True  # whether a correct program accepts a registration here
    is_blind: bool = False  # whether poses come from dead reckoning, and so drift

    @property
    def T_base_target(self) -> RigidTransform:
        """Exact ground truth."""
        return self.T_base_world * self.T_target_world.inv()

    def base_field(self, p_base: Points) -> Vectors:
        """Return the true, noise-free field at the time of the base survey."""
        p_world = transform_points(p_base, self.T_base_world.inv())
        return rotate_vectors(field_of(self.base_sources, p_world) + self.earth_field, self.T_base_world)


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

    __repr__ = brief


class Streams:
    """One independent random stream per cause, so that changing one setting leaves all else as it was."""

    def __init__(self, seed: int) -> None:
        if seed < 0:
            msg = f"the seed must not be negative, got {seed}"
            raise ConfigurationError(msg)
        (
            self.sources, self.elsewhere, self.moves, self.base, self.target,
            self.frames, self.base_errors, self.target_errors, self.probes,
        ) = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(9))  # fmt: skip
