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

    # Infer each map again by the published recursion: zero mean, one sample at a time, the variance of the subset of
    # regressors. Minutes instead of seconds.
    is_recursive: bool = False
    features: FeatureConfig = Field(default_factory=FeatureConfig)
    matching: MatchingConfig = Field(default_factory=MatchingConfig)
    consensus: ConsensusConfig = Field(default_factory=ConsensusConfig)
    decision: FitnessConfig = Field(default_factory=FitnessConfig)


# As printed, where the default is not. Of thresholds that the paper names without a number, ours were chosen so:
LITERAL = PublishedConfig(
    is_recursive=True,
    features=FeatureConfig(
        # 100 G, in bins of 10 G. A field of the Earth's strength, 0.5 G, then only tells the signs of components.
        component_range=0.01,
        # A hundredth of the Earth's 50 uT, squared.
        max_variance=0.5e-6**2,
        min_frame_strength=0.0,
    ),
    # The closer half in one simulated room (office-random, seed 31000100), where 7 in 10 of these were right.
    matching=MatchingConfig(max_distance=0.09),
    # What two fields of 50 uT reach that are 0.1 rad apart: the default's limit, as a product.
    decision=FitnessConfig(max_cross=0.1 * 50e-6**2),
)
