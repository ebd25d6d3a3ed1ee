# SPDX-License-Identifier: BSD-3-Clause
"""What all baselines share: an answer is accepted by the published check, so that none is better off for its own."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.field.map import FieldMap
from magmatch.registration.decide.fitness import alignment_fitness
from magmatch.registration.published.fitness_decision import FitnessConfig, by_fitness
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult


def judged(
    base_map: FieldMap,
    target_map: FieldMap,
    found: RigidTransform | None,
    *,
    n_correspondences: int = 0,
    n_inliers: int = 0,
) -> RegistrationResult:
    """State the answer of a baseline (None where it gave up), judged by the mean misalignment of vectors."""
    if found is None or not np.isfinite(found.as_matrix()).all():
        return by_fitness(SearchResult(n_correspondences=n_correspondences), None, FitnessConfig())
    search = SearchResult((found,), n_correspondences=n_correspondences, n_inliers=n_inliers)
    fitness = alignment_fitness(base_map, target_map.survey, found)
    return by_fitness(search, fitness, FitnessConfig())
