# SPDX-License-Identifier: BSD-3-Clause
"""Smoothing of a log: processed forward to its end and backward to its beginning, as far as both can be believed.

At each pose, the two estimates use the path before it and the path after it. Their errors, above all the map's errors
there, are correlated in an unknown way, so they are fused by covariance intersection, which allows any correlation
(S. Julier and J. Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations, ACC 1997).

A first fix is the best of very many starts, in a map whose errors are known by their spread only: what was fixed by
chance is contradicted by what follows. So a stretch that ended in a contradiction, or that has not been put to the
test, is believed only as far as the other direction, which found the body elsewhere in the log, agrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.geometry import path_walked, transform_from_product
from magmatch.localization.belief import BIN_LENGTH, untested_words
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate, if_accurate
from magmatch.localization.follow_log import follow_log
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.likely_maps import LikelyMaps
from magmatch.localization.track import Track
from magmatch.typing import Mask, Scalars

REFUTED = "the rest of the log contradicts the pose that was probable here"
# Squared distance (chi^2 of six, one in 10,000) from which on two estimates contradict each other.
CONTRADICTION = 27.9


def smooth(known: KnownPlaces, walk: Survey, config: LocalizerConfig) -> Track:
    """Localise a log in a map, using also the samples after each pose; see `localize`."""
    # Whether a fix stands is seen from the whole log.
    there, back = (follow_log(known, log, config, at_once=True) for log in (walk, reversed_log(walk)))
    forward, backward = list(there.estimates), list(reversed(back.estimates))
    both, agree = agreement(forward, backward)
    length = LikelyMaps(known, config).bin_length / BIN_LENGTH
    steps, tested = np.diff(path_walked(walk.positions), prepend=0.0), config.stands * length
    # A step back ends where that step began.
    steps_back = np.concatenate([[0.0], steps[:0:-1]])
    stands = _only(forward, both, agree, steps, tested)
    stands_back = _only(backward[::-1], both[::-1], agree[::-1], steps_back, tested)[::-1]
    lengths = {} if known.atlas is None else {entry.name: entry.table.length for entry in known.atlas.entries}
    joined = in_order(
        [if_accurate(e, config.decision.max_sd(lengths.get(e.map or "", length))) for e in join(stands, stands_back)]
    )
    seconds = {key: there.seconds[key] + back.seconds[key] for key in there.seconds}
    places = back.places if back.is_stated.any() and not there.is_stated.any() else there.places
    return replace(there, estimates=joined, seconds=seconds, places=places)


def _only(
    estimates: Sequence[PoseEstimate], both: Mask, agree: Mask, steps: Scalars, tested: float
) -> list[PoseEstimate]:
    """Estimates without the poses that do not stand, with the reason; the arguments of `believed`."""
    lost, found = PoseEstimate(LocalizerStatus.LOST, REFUTED), list(estimates)
    stands, is_refuted = believed(estimates, both, agree, steps, tested), refuted(estimates, both, agree)
    for n in np.flatnonzero([e.is_stated for e in estimates] & ~stands).tolist():
        e = estimates[n]
        untested = PoseEstimate(LocalizerStatus.LOST, untested_words(e.reason, tested), probability=e.probability)
        found[n] = lost if is_refuted[n] else untested
    return found


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
            key=lambda e: (
                e.is_stated,
                e.status is LocalizerStatus.LOCALIZED,
                e.is_place_known,
                0.0 if e.is_stated else e.probability,
            ),
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


def in_order(joined: Sequence[PoseEstimate]) -> list[PoseEstimate]:
    """Estimates of both directions in the log's: what is unstated is searched for up to the first pose, then lost."""
    first = next((n for n, e in enumerate(joined) if e.is_stated), len(joined))
    unstated = [LocalizerStatus.SEARCHING] * first + [LocalizerStatus.LOST] * (len(joined) - first)
    return [
        e if e.is_stated or e.status is status else replace(e, status=status)
        for e, status in zip(joined, unstated, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class TrustedSpan:
    """Rows ``first`` to ``last`` (inclusive), in the direction of travel: one place, trusted throughout."""

    first: int
    last: int
    is_contradicted: bool  # by what follows it at once

    @property
    def rows(self) -> slice:
        """Give the samples as an index."""
        return slice(self.first, self.last + 1)


def stretches(estimates: Sequence[PoseEstimate]) -> list[TrustedSpan]:
    """Stretches in which poses are stated; a pose that only became too uncertain contradicts nothing."""
    found, first, last = [], -1, len(estimates) - 1
    for n, e in enumerate(estimates):
        if e.is_stated and first < 0:
            first = n
        if first >= 0 and (n == last or not estimates[n + 1].is_stated or estimates[n + 1].map != e.map):
            found.append(TrustedSpan(first, n, n < last and not estimates[n + 1].is_place_known))
            first = -1
    return found


def agreement(a: Sequence[PoseEstimate], b: Sequence[PoseEstimate]) -> tuple[Mask, Mask]:
    """Tell where both directions state a pose, and where these agree: (n,) each."""
    both = np.array([x.is_stated and y.is_stated for x, y in zip(a, b, strict=True)], dtype=np.bool_)
    agree = both & [x.map == y.map for x, y in zip(a, b, strict=True)]
    rows = np.flatnonzero(agree).tolist()
    there, back = stacked([a[n] for n in rows]), stacked([b[n] for n in rows])
    xi = offsets(there[0], back[0])
    agree[rows] = (xi * np.linalg.solve(there[1] + back[1], xi[..., None])[..., 0]).sum(axis=1) <= CONTRADICTION
    return both, agree


def stacked(stated: Sequence[PoseEstimate]) -> tuple[RigidTransform, np.ndarray]:
    """Stated poses ``T_map_body`` (m,) and their covariances (m, 6, 6)."""
    matrices = np.array([e.matrix for e in stated], dtype=np.float64).reshape(-1, 4, 4)
    return transform_from_product(matrices), np.array([e.covariance for e in stated]).reshape(-1, 6, 6)


def offsets(T_map_a: RigidTransform, T_map_b: RigidTransform) -> np.ndarray:
    """Twists (m, 6) from some poses to others."""
    return (T_map_a.inv() * T_map_b).as_exp_coords()


def believed(estimates: Sequence[PoseEstimate], both: Mask, agree: Mask, steps: Scalars, tested: float) -> Mask:
    """Rows whose poses stand, (n,), of estimates in the direction of travel; ``steps``: path from the row before (m).

    Where both directions state poses and mostly disagree, one of the stretches is wrong, and nothing says which. One
    that ended within the path ``tested`` (m) counts up to where the other direction agrees; so does one that ended in
    a contradiction, or up to that path before its end if it had stood before that. Only path in the map counts.
    """
    walked = np.cumsum(np.where([e.status is LocalizerStatus.DEAD_RECKONING for e in estimates], 0.0, steps))
    stands = np.zeros(len(estimates), dtype=np.bool_)
    for one in stretches(estimates):
        met, agreed = both[one.rows], agree[one.rows]
        if one.is_contradicted:
            # The contradiction began within the path by which a place is doubted; what stood before that still does.
            back = walked[one.last] - walked[one.rows]
            if back[0] >= 2 * tested and not _mostly_disagree(met, agreed):
                stands[one.rows] = back >= tested
        is_tested = walked[one.last] - walked[one.first] >= tested and not one.is_contradicted
        if agreed.any() and not is_tested:
            stands[one.first : one.first + int(np.flatnonzero(agreed)[-1]) + 1] = True
        elif is_tested and not _mostly_disagree(met, agreed):
            stands[one.rows] = True
    return stands


def refuted(estimates: Sequence[PoseEstimate], both: Mask, agree: Mask) -> Mask:
    """Rows of stretches that are contradicted, (n,): by what follows at once, or mostly by the other direction."""
    found = np.zeros(len(estimates), dtype=np.bool_)
    for one in stretches(estimates):
        found[one.rows] = one.is_contradicted or _mostly_disagree(both[one.rows], agree[one.rows])
    return found


def _mostly_disagree(met: Mask, agreed: Mask) -> bool:
    """Whether both directions meet, and agree at less than half of these poses."""
    return bool(met.any()) and bool(agreed.sum() < 0.5 * met.sum())
