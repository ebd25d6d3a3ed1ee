# SPDX-License-Identifier: BSD-3-Clause
"""KISS-Matcher on this package's keypoints: the published descriptor's matches, pruned and solved by ROBIN and GNC.

References
----------
H. Lim et al., KISS-Matcher: Fast and Robust Point Cloud Registration Revisited, ICRA 2025, arXiv:2409.15615.
"""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.features.config import FeatureConfig
from magmatch.features.extract import extract_features
from magmatch.field.map import FieldMap
from magmatch.published.config import PublishedConfig
from magmatch.published.matching import MatchingConfig, match
from magmatch.published.register import comparable
from magmatch.registration.result import RegistrationResult
from magmatch_evaluation.baselines.judged import judged


class KissConfig(BaseModel):
    """Keypoints, their matches, and how noisy a match may be."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    features: FeatureConfig = Field(default_factory=FeatureConfig)
    matching: MatchingConfig = Field(default_factory=MatchingConfig)
    # Bound of a match's error, spacings of the grid that keypoints lie on.
    noise_bound: float = Field(default=1.5, gt=0)


def register_by_kiss_matcher(
    base_map: FieldMap,
    target_map: FieldMap,
    config: KissConfig,
    seed: int,  # noqa: ARG001  (draws nothing)
) -> RegistrationResult:
    """Register two maps by KISS-Matcher's solver over matched keypoints."""
    import kiss_matcher  # has no release for the newest Python

    features = comparable(base_map, target_map, PublishedConfig(features=config.features)).features
    base, target = (extract_features(m, features) for m in (base_map, target_map))
    matches = match(base.descriptors, target.descriptors, config.matching)
    if len(matches) < 3:
        return judged(base_map, target_map, None, n_correspondences=len(matches))
    settings = kiss_matcher.KISSMatcherConfig(config.noise_bound * (features.spacing or 0.0))
    solver = kiss_matcher.KISSMatcher(settings)
    # Its solver works in single precision: about the middle of either cloud.
    p_base, p_target = base.positions[matches.base_rows], target.positions[matches.target_rows]
    to_base, to_target = p_base.mean(axis=0), p_target.mean(axis=0)
    answer = solver.solve((p_target - to_target).T, (p_base - to_base).T)
    if not answer.valid:
        return judged(base_map, target_map, None, n_correspondences=len(matches))
    R = Rotation.from_matrix(np.array(answer.rotation, dtype=np.float64))
    t = np.array(answer.translation, dtype=np.float64) + to_base - R.apply(to_target)
    T, n_inliers = RigidTransform.from_components(t, R), int(solver.get_num_final_inliers())
    return judged(base_map, target_map, T, n_correspondences=len(matches), n_inliers=n_inliers)
