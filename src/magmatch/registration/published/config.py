# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the published method, step by step."""

from pydantic import BaseModel, ConfigDict, Field

from magmatch.features.config import FeatureConfig
from magmatch.registration.published.consensus import ConsensusConfig
from magmatch.registration.published.fitness_decision import FitnessConfig
from magmatch.registration.published.matching import MatchingConfig


class PublishedConfig(BaseModel):
    """The steps of the published method."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    features: FeatureConfig = Field(default_factory=FeatureConfig)
    matching: MatchingConfig = Field(default_factory=MatchingConfig)
    consensus: ConsensusConfig = Field(default_factory=ConsensusConfig)
    decision: FitnessConfig = Field(default_factory=FitnessConfig)
