# SPDX-License-Identifier: BSD-3-Clause
"""What all baselines share: an answer is accepted by the published check, so that none is better off for its own."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.field.map import FieldMap
from magmatch.published import fitness
from magmatch.published.fitness import FitnessConfig
from magmatch.registration.published_answer import state_check
from magmatch.registration.result import RegistrationResult


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
        answer = state_check((), None, FitnessConfig())
    else:
        answer = state_check((found,), fitness(base_map, target_map.survey, found), FitnessConfig())
    return replace(answer, n_correspondences=n_correspondences, n_inliers=n_inliers)
