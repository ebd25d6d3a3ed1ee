# SPDX-License-Identifier: BSD-3-Clause
"""The output of a search: poses for refinement, best first."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True, eq=False, slots=True)
class SearchResult:
    """All that a search found."""

    poses: tuple[RigidTransform, ...] = ()  # distinct ``T_base_target``, best first; empty if nothing was found
    n_keypoints: int = 0
    n_correspondences: int = 0
    # Whether all poses are refined, however clear the first are: those of somebody else are in no order.
    is_unordered: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Given:
    """Poses from elsewhere, to be weighed beside those of the search, or alone."""

    poses: tuple[RigidTransform, ...] = ()  # ``T_base_target``, in the surveys' frames
    is_alone: bool = False

    def between(self, T_base_model: RigidTransform, T_target_model: RigidTransform) -> SearchResult:
        """Express the poses in the frames in which poses are searched."""
        poses = tuple(T_base_model.inv() * T * T_target_model for T in self.poses)
        return SearchResult(poses, is_unordered=True)


NONE_GIVEN = Given()
