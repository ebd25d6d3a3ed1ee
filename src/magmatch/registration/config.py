# SPDX-License-Identifier: BSD-3-Clause
"""Settings of a registration; presets are named instances."""

from math import exp
from typing import Literal

from pydantic import Field

from magmatch.arguments import expect_kind
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.published.config import LITERAL, PublishedConfig
from magmatch.published.register import FIELD
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.refine.refinement import RefinementConfig
from magmatch.settings import Settings


class RegistrationConfig(Settings):
    """What a user knows and asks for; how much is tried is in `estimation/limits.py`."""

    # How surveys are mapped.
    field: FieldConfig = SPLINE
    # 'invariants': a frame and a descriptor at every point; 'pairs': pairs of points, for a walk, along which the
    # gradient across it is unknown; 'auto': pairs for short lines, invariants otherwise and if pairs refuse;
    # 'keypoints': the published method, which uses only `field` and `keypoints`.
    search: Literal["auto", "invariants", "pairs", "keypoints"] = "auto"
    # If readings turn with their sensor, calibrate it as `magmatch prepare` does, register again, and keep the better
    # answer.
    calibrate: bool = True
    # What is known of the pose beforehand.
    prior: PosePriorConfig = Field(default_factory=PosePriorConfig)
    keypoints: PublishedConfig = Field(default_factory=PublishedConfig)
    refinement: RefinementConfig = Field(default_factory=RefinementConfig)
    decision: DecisionConfig = Field(default_factory=DecisionConfig)

    def with_log_prior(self, more: float) -> "RegistrationConfig":
        """The same, at so much log prior odds more that the surveys share a place."""
        odds = self.decision.prior_odds * exp(more)
        return self.model_copy(update={"decision": self.decision.model_copy(update={"prior_odds": odds})})


PRESETS: dict[str, RegistrationConfig] = {
    "default": RegistrationConfig(),
    # The published method with the corrections of docs/theory/published.md, every sample used.
    "paper": RegistrationConfig(field=FIELD, search="keypoints", calibrate=False),
    # The same to the letter, printed slips apart; slow.
    "paper-literal": RegistrationConfig(field=FIELD, search="keypoints", calibrate=False, keypoints=LITERAL),
}


def settings_of(config: RegistrationConfig | None) -> RegistrationConfig:
    """The settings given, or the preset ``default``."""
    if config is None:
        return PRESETS["default"]
    expect_kind(config, "config", (RegistrationConfig,), f"PRESETS holds some: {', '.join(PRESETS)}")
    return config
