# SPDX-License-Identifier: BSD-3-Clause
"""The output of a search: poses for refinement, best first."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from magmatch.registration.result import NO_LINKS, Links

# Distinct poses that a search hands on, at most.
N_CANDIDATES = 8


@dataclass(frozen=True, eq=False, slots=True)
class SearchResult:
    """All that a search found."""

    poses: tuple[RigidTransform, ...] = ()  # distinct ``T_base_target``, best first; empty if nothing was found
    n_keypoints: int = 0
    n_correspondences: int = 0
    n_inliers: int = 0  # of the best pose
    links: Links = NO_LINKS  # corresponding points that support it
