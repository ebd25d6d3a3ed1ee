# SPDX-License-Identifier: BSD-3-Clause
"""A method: two surveys in, a registration result out, whatever happens in between."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from pydantic import BaseModel
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.register import register
from magmatch.registration.result import RegistrationResult

MapBuilder = Callable[[Survey, FieldConfig], FieldMap]


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """What every method is given.

    Attributes
    ----------
    base, target : Survey
        Each in its own frame.
    seed : int
        Of whatever the method draws.
    rough_start : RigidTransform
        The truth, spoilt: for methods that only refine. Those that search must not look at it.
    build : callable
        Makes a map of a survey; methods that want the same map share it.
    """

    base: Survey
    target: Survey
    seed: int
    rough_start: RigidTransform
    build: MapBuilder


class Method(Protocol):
    """One way to register two surveys; its ``repr`` holds all settings.

    Attributes
    ----------
    name : str
        As typed on the command line.
    title : str
        What it is, in a few words.
    module : str or None
        What must be installed for it.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def title(self) -> str: ...  # noqa: D102
    @property
    def module(self) -> str | None: ...  # noqa: D102

    def __call__(self, task: Task) -> RegistrationResult:
        """Register the pair."""


@dataclass(frozen=True, slots=True)
class Preset:
    """Registration of this package with given settings."""

    name: str
    title: str
    config: RegistrationConfig
    module: str | None = None

    def __call__(self, task: Task) -> RegistrationResult:
        """Register the pair; a target that is a walk needs no map, so only the published method is given one."""
        base, target = task.build(task.base, self.config.field), task.target
        if self.config.search == "keypoints":
            return register(base, task.build(target, self.config.field), self.config, seed=task.seed)
        return register(base, target, self.config, seed=task.seed)


@dataclass(frozen=True, slots=True)
class Baseline:
    """A method of the room of baselines: it takes maps of one prior.

    Attributes
    ----------
    name, title, module
        See `Method`.
    prior : FieldConfig
        How the maps are made.
    settings : BaseModel
    solve : callable
        ``solve(base_map, target_map, settings, seed)``; not in the ``repr``, where it would show an address.
    """

    name: str
    title: str
    prior: FieldConfig
    settings: BaseModel
    solve: Callable[[FieldMap, FieldMap, Any, int], RegistrationResult] = field(repr=False)
    module: str | None = None

    def __call__(self, task: Task) -> RegistrationResult:
        """Register the pair."""
        maps = (task.build(task.base, self.prior), task.build(task.target, self.prior))
        return self.solve(*maps, self.settings, task.seed)


@dataclass(frozen=True, slots=True)
class Refiner:
    """A method that needs a start: the rough one, or the identity as if both frames were the same.

    Attributes
    ----------
    name, title, module, prior, settings
        See `Baseline`.
    solve : callable
        ``solve(base_map, target_map, start, settings, seed)``.
    is_rough : bool
        Whether it is given the rough start.
    """

    name: str
    title: str
    prior: FieldConfig
    settings: BaseModel
    solve: Callable[[FieldMap, FieldMap, RigidTransform, Any, int], RegistrationResult] = field(repr=False)
    is_rough: bool = True
    module: str | None = None

    def __call__(self, task: Task) -> RegistrationResult:
        """Register the pair."""
        start = task.rough_start if self.is_rough else RigidTransform.identity()
        maps = (task.build(task.base, self.prior), task.build(task.target, self.prior))
        return self.solve(*maps, start, self.settings, task.seed)
