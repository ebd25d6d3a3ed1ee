# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the published method, step by step."""

from pydantic import Field

from magmatch.features.config import FeatureConfig
from magmatch.published.consensus import ConsensusConfig
from magmatch.published.fitness import FitnessConfig
from magmatch.published.matching import MatchingConfig
from magmatch.settings import Settings


class PublishedConfig(Settings):
    """The steps of the published method."""

    features: FeatureConfig = Field(default_factory=FeatureConfig)
    matching: MatchingConfig = Field(default_factory=MatchingConfig)
    consensus: ConsensusConfig = Field(default_factory=ConsensusConfig)
    decision: FitnessConfig = Field(default_factory=FitnessConfig)
