# SPDX-License-Identifier: BSD-3-Clause
"""The methods that are compared: two surveys in, a registration result out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from pydantic import BaseModel
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.field.map import FieldMap
from magmatch.registration.config import PRESETS, RegistrationConfig
from magmatch.registration.register import register
from magmatch.registration.result import RegistrationResult
from magmatch_evaluation.baselines.hov_kiss import KissConfig, register_by_kiss_matcher
from magmatch_evaluation.baselines.local_refinement import GicpConfig, register_by_gicp, register_by_refinement
from magmatch_evaluation.baselines.sift_layers import SiftConfig, register_by_sift
from magmatch_evaluation.survey_pairs import ROUGH_WORDS

PAPER, OUR_FIELD = PRESETS["paper"], SPLINE


@dataclass(frozen=True, eq=False, slots=True)
class MethodInput:
    """What every method is given.

    ``rough_start`` is the truth, spoilt, for methods that only refine: those that search must not look at it.
    ``build`` makes the map of a survey; methods that want the same map share it.
    """

    base: Survey
    target: Survey
    seed: int
    rough_start: RigidTransform
    build: Callable[[Survey, FieldConfig], FieldMap]


class Method(Protocol):
    """One way to register the surveys of a `MethodInput`, or to predict a `HeldOut` field.

    Its ``repr`` holds all settings; ``module`` is what must be installed for it, if anything.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def title(self) -> str: ...  # noqa: D102
    @property
    def module(self) -> str | None: ...  # noqa: D102

    def __call__(self, task: Any, /) -> Any:
        """Give a `RegistrationResult`, or the figures of a prediction."""


@dataclass(frozen=True, slots=True)
class Preset:
    """Registration of this package with given settings."""

    name: str
    title: str
    config: RegistrationConfig
    module: str | None = None

    def __call__(self, task: MethodInput) -> RegistrationResult:
        """Register the pair; a target that is a walk needs no map, so only the published method is given one."""
        base, target = task.build(task.base, self.config.field), task.target
        if self.config.search == "keypoints":
            return register(base, task.build(target, self.config.field), self.config, seed=task.seed)
        return register(base, target, self.config, seed=task.seed)


@dataclass(frozen=True, slots=True)
class Baseline:
    """Another method: ``solve(base_map, target_map, [start,] settings, seed)`` over maps of one prior.

    ``solve`` is not in the ``repr``, where it would show an address. A method that only refines starts at the rough
    pose, or at the identity as if both frames were the same.
    """

    name: str
    title: str
    prior: FieldConfig
    settings: BaseModel
    solve: Callable[..., RegistrationResult] = field(repr=False)
    start: Literal["rough", "identity"] | None = None
    module: str | None = None

    def __call__(self, task: MethodInput) -> RegistrationResult:
        """Register the pair."""
        inputs: list[Any] = [task.build(task.base, self.prior), task.build(task.target, self.prior)]
        if self.start is not None:
            inputs.append(task.rough_start if self.start == "rough" else RigidTransform.identity())
        return self.solve(*inputs, self.settings, task.seed)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Preset("default", "this package's method", PRESETS["default"]),
        Preset("paper", "the published method (Mag-Match), corrections of docs/theory/published.md", PAPER),
        Baseline(
            "sift", "SIFT on horizontal layers of |B|, as published", PAPER.field, SiftConfig(), register_by_sift
        ),
        Baseline(
            "sift-best", "SIFT on layers in 31 directions, of this package's maps",
            OUR_FIELD, SiftConfig(directions="many", layer_gap=3.0, max_layers=12), register_by_sift,
        ),
        Baseline(
            "kiss", "KISS-Matcher's solver on the published keypoints",
            PAPER.field, KissConfig(), register_by_kiss_matcher, module="kiss_matcher",
        ),
        Baseline(
            "gicp", f"GICP on surfaces of equal |B|, {ROUGH_WORDS}",
            OUR_FIELD, GicpConfig(), register_by_gicp, "rough",
        ),
        Baseline(
            "refine-rough", f"this package's refinement alone, {ROUGH_WORDS}",
            OUR_FIELD, PRESETS["default"], register_by_refinement, "rough",
        ),
        Baseline(
            "refine-identity", "this package's refinement alone, from the identity",
            OUR_FIELD, PRESETS["default"], register_by_refinement, "identity",
        ),
    )
}  # fmt: skip
