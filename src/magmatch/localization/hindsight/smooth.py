# SPDX-License-Identifier: BSD-3-Clause
"""Smoothing of a log: processed forward to its end and backward to its beginning.

At each pose, the two estimates use the path before it and the path after it. What the rest of the log contradicts is
left out (`stretches.py`). Their errors, above all the map's errors there, are correlated in an unknown way, so they
are fused by covariance intersection, which allows any correlation (S. Julier and J. Uhlmann, A non-divergent
estimation algorithm in the presence of unknown correlations, ACC 1997).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import expect_kind
from magmatch.data.survey import Survey
from magmatch.geometry import path_walked
from magmatch.localization.belief import BIN_LENGTH
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.localization.follow_log import follow_log
from magmatch.localization.hindsight.stretches import agreement, believed, offsets, stacked
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.likely_maps import LikelyMaps
from magmatch.localization.track import Track
from magmatch.typing import Mask

REFUTED = "the rest of the log contradicts the pose that was probable here"


def smooth(known: KnownPlaces, walk: Survey, config: LocalizerConfig | None = None) -> Track:
    """Localise a log in a map, using also the samples after each pose; see `localize`."""
    config = config or LocalizerConfig()
    expect_kind(config, "config", (LocalizerConfig,))
    # Whether a fix stands is seen from the whole log.
    there, back = (follow_log(known, log, config, at_once=True) for log in (walk, reversed_log(walk)))
    forward, backward = list(there.estimates), list(reversed(back.estimates))
    both, agree = agreement(forward, backward)
    length = LikelyMaps(known, config).bin_length / BIN_LENGTH
    steps, tested = np.diff(path_walked(walk.positions), prepend=0.0), config.stands * length
    stands = believed(forward, both, agree, steps, tested)
    # A step back ends where that step began.
    steps_back = np.concatenate([[0.0], steps[:0:-1]])
    stands_back = believed(backward[::-1], both[::-1], agree[::-1], steps_back, tested)[::-1]
    joined = join(_only(forward, stands), _only(backward, stands_back))
    seconds = {key: there.seconds[key] + back.seconds[key] for key in there.seconds}
    places = back.places if back.is_stated.any() and not there.is_stated.any() else there.places
    return replace(there, estimates=joined, seconds=seconds, places=places)


def _only(estimates: Sequence[PoseEstimate], stands: Mask) -> list[PoseEstimate]:
    """Estimates without the poses that do not stand."""
    lost = PoseEstimate(LocalizerStatus.LOST, REFUTED)
    return [lost if e.is_stated and not ok else e for e, ok in zip(estimates, stands, strict=True)]


def reversed_log(walk: Survey) -> Survey:
    """Walk the path backward."""
    times, R = walk.times, walk.orientations
    return replace(
        walk,
        positions=walk.positions[::-1],
        field=walk.field[::-1],
        times=None if times is None else -times[::-1],
        orientations=None if R is None else R[::-1],
    )


def join(forward: Sequence[PoseEstimate], backward: Sequence[PoseEstimate]) -> list[PoseEstimate]:
    """Fuse the estimates of both directions; where they contradict each other, state nothing."""
    both, agree = agreement(forward, backward)
    refuted = PoseEstimate(LocalizerStatus.LOST, "the path before and the path behind contradict each other")
    joined = []
    for n, (pair, contradicts) in enumerate(zip(zip(forward, backward, strict=True), both & ~agree, strict=True)):
        # What else is said is that of the direction with more of the path behind it.
        order = pair if 2 * n >= len(both) else pair[::-1]
        better = max(
            order,
            key=lambda e: (e.is_stated, e.status is LocalizerStatus.LOCALIZED, 0.0 if e.is_stated else e.probability),
        )
        joined.append(refuted if contradicts else better)
    rows = np.flatnonzero(agree).tolist()
    (T_map_a, A), (T_map_b, B) = (stacked([each[n] for n in rows]) for each in (forward, backward))
    # Both weigh one half.
    A, B = np.linalg.inv(A) / 2, np.linalg.inv(B) / 2
    C = np.linalg.inv(A + B)
    xi = C @ B @ offsets(T_map_a, T_map_b)[..., None]
    matrices = (T_map_a * RigidTransform.from_exp_coords(xi[..., 0])).as_matrix()
    for n, T, covariance in zip(rows, matrices, (C + np.swapaxes(C, 1, 2)) / 2, strict=True):
        joined[n] = replace(joined[n], matrix=T, covariance=covariance)
    return joined
