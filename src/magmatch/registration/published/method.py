# SPDX-License-Identifier: BSD-3-Clause
"""The published method [McDonald2025]: keypoints, HOV descriptors, nearest neighbours, vector MSAC, fitness."""

import logging

import numpy as np

from magmatch.features.config import FeatureConfig
from magmatch.features.extract import extract_features, shared_range
from magmatch.features.features import Features
from magmatch.features.grids import grid_spacing
from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.decide.fitness import alignment_fitness
from magmatch.registration.published.config import PublishedConfig
from magmatch.registration.published.consensus import Consensus, vector_msac
from magmatch.registration.published.fitness_decision import by_fitness
from magmatch.registration.published.matching import Correspondences, match_features
from magmatch.registration.result import Links, RegistrationResult
from magmatch.registration.search.candidate import SearchResult

log = logging.getLogger(__name__)


def register_published(
    base_map: FieldMap, target_map: FieldMap, config: PublishedConfig, seed: int, clock: Clock
) -> RegistrationResult:
    """Register two maps as published; covariance and probability are None, since the method gives neither."""
    with clock("search"):
        found = keypoint_search(base_map, target_map, config, np.random.default_rng(seed))
    with clock("decide"):
        fitness = alignment_fitness(base_map, target_map.survey, found.poses[0]) if found.poses else None
        return by_fitness(found, fitness, config.decision)


def keypoint_search(
    base_map: FieldMap, target_map: FieldMap, config: PublishedConfig, rng: np.random.Generator
) -> SearchResult:
    """Find poses under which many keypoints of two maps coincide."""
    features = comparable(base_map, target_map, config.features)
    half_range = shared_range([base_map, target_map], features)
    base, target = (extract_features(one, features, half_range) for one in (base_map, target_map))
    matches = match_features(base, target, config.matching)
    log.info("%d and %d keypoints, %d correspondences", len(base), len(target), len(matches))
    rows = matches.base_rows, matches.target_rows
    found = vector_msac(
        base.positions[rows[0]], target.positions[rows[1]], base.field[rows[0]], target.field[rows[1]],
        config.consensus.inlier_distance * (features.spacing or 0.0), config.consensus, rng,
    )  # fmt: skip
    return state_consensus(base, target, matches, found)


def comparable(base_map: FieldMap, target_map: FieldMap, config: FeatureConfig) -> FeatureConfig:
    """Settings with the coarser spacing for both maps, since descriptors depend on the size of the support."""
    spacing = max(grid_spacing(m, config) for m in (base_map, target_map))
    return config.model_copy(update={"spacing": spacing})


def state_consensus(
    base: Features, target: Features, matches: Correspondences, found: list[Consensus]
) -> SearchResult:
    """Poses, counts and links of a search."""
    n_keypoints = len(base) + len(target)
    if not found:
        return SearchResult(n_keypoints=n_keypoints, n_correspondences=len(matches))
    inlier = found[0].is_inlier
    return SearchResult(
        poses=tuple(c.T_base_target for c in found),
        n_keypoints=n_keypoints,
        n_correspondences=len(matches),
        n_inliers=int(inlier.sum()),
        links=Links(base.positions[matches.base_rows[inlier]], target.positions[matches.target_rows[inlier]]),
    )
