# SPDX-License-Identifier: BSD-3-Clause
"""`register`: the published method [McDonald2025], step by step; detector, descriptor and matcher can be replaced."""

import logging
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import expect_kind, rows_chosen, whole_number_of
from magmatch.data.checks import ADVICE
from magmatch.data.survey import Survey
from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import component_range, describe
from magmatch.features.extract import Features, features_of
from magmatch.features.infer import Inferred, grid_spacing, infer
from magmatch.features.keypoints import detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.field.map import FieldMap
from magmatch.published.config import PublishedConfig
from magmatch.published.consensus import Consensus, consensus
from magmatch.published.fitness import Fitness, fitness
from magmatch.published.matching import Matches, match
from magmatch.published.recursion import recursively
from magmatch.threads import side_by_side
from magmatch.typing import Indices, Mask, Matrix

log = logging.getLogger(__name__)

# The published prior; every sample is used.
FIELD = FieldConfig(prior="divergence_free", leave_out_outliers=False)


class Detector(Protocol):
    """Chooses keypoints, as `detect` does."""

    def __call__(self, inferred: Inferred, /) -> Indices:
        """Rows of X* that are keypoints."""


class Descriptor(Protocol):
    """Describes keypoints, as `describe` does."""

    def __call__(self, inferred: Inferred, frames: LocalFrames, /) -> Matrix:
        """One row a keypoint, (k, d), that no motion of the map changes."""


class Matcher(Protocol):
    """Finds correspondences, as `match` does."""

    def __call__(self, base: Matrix, target: Matrix, /) -> Matches:
        """Rows of the base's and the target's descriptors that belong together."""


@dataclass(frozen=True, eq=False, slots=True)
class Published:
    """The findings of the published method, with everything that led to them.

    Attributes
    ----------
    base, target : Features
        Keypoints of both maps, each in its map's frame.
    matches : Matches
        Corresponding keypoints.
    candidates : tuple of Consensus
        Distinct transforms that many matches agree on, best first; empty if there is none.
    check : Fitness or None
        The final check of the first candidate; None if there is none.
    config : PublishedConfig
        Settings as they were used, the spacing and range that both maps share among them.
    """

    base: Features
    target: Features
    matches: Matches
    candidates: tuple[Consensus, ...]
    check: Fitness | None
    config: PublishedConfig

    def __repr__(self) -> str:
        state = "accepted" if self.is_accepted else "not accepted"
        return (
            f"Published({state}: {len(self.base)} and {len(self.target)} keypoints, {len(self.matches)} matches, "
            f"{int(self.inliers.sum())} inliers, {'no pose' if self.check is None else self.check})"
        )

    @property
    def is_accepted(self) -> bool:
        """Whether the best transform passes the final check."""
        return self.check is not None and self.check.passes(self.config.decision)

    @property
    def T_base_target(self) -> RigidTransform | None:
        """The best transform; None unless it is accepted."""
        return self.candidates[0].T_base_target if self.is_accepted else None

    @property
    def inliers(self) -> Mask:
        """Which matches support the best transform: (c,) bool."""
        return self.candidates[0].is_inlier if self.candidates else np.zeros(len(self.matches), dtype=np.bool_)


def register(
    base: Survey | FieldMap,
    target: Survey | FieldMap,
    *,
    detector: Detector | None = None,
    descriptor: Descriptor | None = None,
    matcher: Matcher | None = None,
    config: PublishedConfig | None = None,
    seed: int = 0,
) -> Published:
    """Register two surveys or maps as published, or with parts of your own.

    Parameters
    ----------
    base, target : Survey or FieldMap
        Surveys are mapped with the published prior (`FIELD`); maps are used as they are, whatever their prior.
    detector, descriptor, matcher : callables, optional
        In place of `detect`, `describe` and `match`: `Detector`, `Descriptor`, `Matcher`.
    config : PublishedConfig, optional
        Settings of the published parts.
    seed : int
        Of the consensus' random draws.

    Returns
    -------
    Published
        Keypoints, matches, candidates, and whether the best of them is accepted.

    Raises
    ------
    ValueError, TypeError
        A part of your own returns something else than its protocol says: rows that X* does not have, a descriptor
        that is not finite, or not one row a keypoint.

    Notes
    -----
    Both maps are asked at one spacing, the coarser of theirs, and described over one range, the larger, since a
    descriptor depends on both.

    References
    ----------
    W. McDonald, C. Le Gentil, J. Wakulicz, T. Vidal-Calleja, Mag-Match, IROS 2025, arXiv:2508.15300.
    """
    for name, side in (("base", base), ("target", target)):
        expect_kind(side, name, (Survey, FieldMap), ADVICE)
    whole_number_of(seed, "seed")
    config = config or PublishedConfig()
    base_map, target_map = side_by_side(_as_map, (base, target))
    if config.is_recursive:
        base_map, target_map = side_by_side(recursively, (base_map, target_map))
    config = comparable(base_map, target_map, config)
    detector = detector or partial(detect, config=config.features)
    descriptor = descriptor or partial(describe, half_range=config.features.component_range)
    matcher = matcher or partial(match, config=config.matching)

    at = [infer(one, config.features) for one in (base_map, target_map)]
    frames = [local_frames(one, _rows_of(detector(one), one), config.features) for one in at]
    descriptors = [_described(descriptor(one, some), some) for one, some in zip(at, frames, strict=True)]
    matches = matcher(*descriptors)
    expect_kind(matches, "matcher", (Matches,), "return magmatch.published.Matches")
    base_features, target_features = (features_of(*parts) for parts in zip(at, frames, descriptors, strict=True))
    log.info("%d and %d keypoints, %d matches", len(base_features), len(target_features), len(matches))
    found = consensus(base_features, target_features, matches, at[0].spacing, config.consensus, seed)
    check = fitness(base_map, target_map.survey, found[0].T_base_target) if found else None
    return Published(base_features, target_features, matches, tuple(found), check, config)


def comparable(base_map: FieldMap, target_map: FieldMap, config: PublishedConfig | None = None) -> PublishedConfig:
    """Settings with one spacing and one range for both maps, on which descriptors depend.

    Parameters
    ----------
    base_map, target_map : FieldMap
    config : PublishedConfig, optional
        Settings of the published parts.

    Returns
    -------
    PublishedConfig
        Its ``features`` are what `infer` and `local_frames` of both maps, and `describe` (its ``component_range``),
        are to be given.
    """
    config = config or PublishedConfig()
    features: FeatureConfig = config.features
    maps = base_map, target_map
    spacing = max(grid_spacing(one, features) for one in maps)
    half_range = features.component_range or max(component_range(one.survey.field) for one in maps)
    shared = features.model_copy(update={"spacing": spacing, "component_range": half_range})
    return config.model_copy(update={"features": shared})


def _as_map(side: Survey | FieldMap) -> FieldMap:
    return side if isinstance(side, FieldMap) else build_map(side, FIELD)


def _rows_of(keypoints: Indices, at: Inferred) -> Indices:
    """Rows of X* that a detector chose: as given, or where its mask is true."""
    rows = rows_chosen(keypoints, len(at))
    return np.flatnonzero(rows) if rows.dtype == np.bool_ else rows


def _described(rows: Matrix, frames: LocalFrames) -> Matrix:
    """Descriptors, if they are one finite row a keypoint."""
    found = np.asarray(rows, dtype=np.float64)
    is_shaped = found.ndim == 2 and len(found) == len(frames)
    if not is_shaped or not np.isfinite(found).all():
        what = "rows that are not finite" if is_shaped else f"shape {found.shape}"
        msg = f"descriptor: expected one finite row for each of {len(frames)} keypoints, got {what}"
        raise ValueError(msg)
    return found
