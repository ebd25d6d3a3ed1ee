# SPDX-License-Identifier: BSD-3-Clause
"""The output of a search: candidate poses for refinement, best first."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.registration.result import Links

# Distinct poses that a search hands on, at most.
N_CANDIDATES = 8


@dataclass(frozen=True, slots=True)
class Candidate:
    """A pose that may be right."""

    T_base_target: RigidTransform  # ``p_base = T p_target``
    score: float  # higher is better; comparable only within one search


@dataclass(frozen=True, eq=False, slots=True)
class SearchResult:
    """All that a search found."""

    candidates: tuple[Candidate, ...] = ()  # distinct poses, best first; empty if nothing was found
    n_keypoints: int = 0
    n_correspondences: int = 0
    n_inliers: int = 0  # of the best candidate
    # Corresponding points that support it
    links: Links = field(default_factory=lambda: Links(np.zeros((0, 3)), np.zeros((0, 3))))

    @property
    def poses(self) -> list[RigidTransform]:
        """The candidates' poses, best first."""
        return [candidate.T_base_target for candidate in self.candidates]
