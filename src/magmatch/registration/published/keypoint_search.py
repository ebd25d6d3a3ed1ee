# SPDX-License-Identifier: BSD-3-Clause
"""The published search: keypoints of both maps, nearest neighbours between their HOV descriptors, vector MSAC."""

import logging

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magmatch.features.config import FeatureConfig
from magmatch.features.extract import extract_features, shared_range
from magmatch.features.features import Features
from magmatch.features.grids import grid_spacing
from magmatch.field.map import FieldMap
from magmatch.registration.published.consensus import Consensus, ConsensusConfig, vector_msac
from magmatch.registration.published.matching import Correspondences, MatchingConfig, match_features
from magmatch.registration.result import Links
from magmatch.registration.search.candidate import Candidate, SearchResult

log = logging.getLogger(__name__)


class KeypointSearchConfig(BaseModel):
    """The steps of the published method."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    features: FeatureConfig = Field(default_factory=FeatureConfig)
    matching: MatchingConfig = Field(default_factory=MatchingConfig)
    consensus: ConsensusConfig = Field(default_factory=ConsensusConfig)


def keypoint_search(
    base_map: FieldMap, target_map: FieldMap, config: KeypointSearchConfig, rng: np.random.Generator
) -> SearchResult:
    """Find poses under which many keypoints of two maps coincide."""
    features_config = comparable(base_map, target_map, config.features)
    half_range = shared_range([base_map, target_map], features_config)
    base = extract_features(base_map, features_config, half_range)
    target = extract_features(target_map, features_config, half_range)
    matches = match_features(base, target, config.matching)
    log.info("%d and %d keypoints, %d correspondences", len(base), len(target), len(matches))

    found = vector_msac(
        base.positions[matches.base_rows],
        target.positions[matches.target_rows],
        base.field[matches.base_rows],
        target.field[matches.target_rows],
        config.consensus.inlier_distance * (features_config.spacing or 0.0),
        config.consensus,
        rng,
    )
    return _state(base, target, matches, found)


def comparable(base_map: FieldMap, target_map: FieldMap, config: FeatureConfig) -> FeatureConfig:
    """Settings with one spacing for both maps, the coarser: supports of another size have other descriptors."""
    spacing = max(grid_spacing(m, config) for m in (base_map, target_map))
    return config.model_copy(update={"spacing": spacing})


def _state(base: Features, target: Features, matches: Correspondences, found: list[Consensus]) -> SearchResult:
    """Candidates, counts and links of a search."""
    n_keypoints = len(base) + len(target)
    if not found:
        return SearchResult(n_keypoints=n_keypoints, n_correspondences=len(matches))
    inlier = found[0].is_inlier
    return SearchResult(
        candidates=tuple(Candidate(c.T_base_target, 1 - c.cost) for c in found),
        n_keypoints=n_keypoints,
        n_correspondences=len(matches),
        n_inliers=int(inlier.sum()),
        links=Links(base.positions[matches.base_rows[inlier]], target.positions[matches.target_rows[inlier]]),
    )
