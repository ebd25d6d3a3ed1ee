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
from dataclasses import replace
from itertools import groupby

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.geometry import path_walked, transform_from_product
from magmatch.localization.belief import untested_words
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate, if_accurate
from magmatch.localization.follow_log import follow_log
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.track import Track
from magmatch.typing import Mask, Scalars

REFUTED = "the rest of the log contradicts the pose that was probable here"
# Squared distance (chi^2 of six, one in 10,000) from which on two estimates contradict each other.
CONTRADICTION = 27.9


def smooth(known: KnownPlaces, walk: Survey, config: LocalizerConfig) -> Track:
    """Localise a log in a map, using also the samples after each pose; see `localize`."""
    # Whether a fix stands is seen from the whole log.
    there, back = (follow_log(known, log, config, at_once=True) for log in (walk, reversed_log(walk)))
    both, agree = agreement(there.estimates, back.estimates[::-1])
    # A step back ends where that step began.
    steps, tested = np.diff(path_walked(walk.positions)), config.stands * known.length
    forward = believed(there.estimates, both, agree, np.append(0.0, steps), tested)
    backward = believed(back.estimates, both[::-1], agree[::-1], np.append(0.0, steps[::-1]), tested)
    lengths = {} if known.atlas is None else {entry.name: entry.table.length for entry in known.atlas.entries}
    joined = [
        if_accurate(e, config.decision.max_sd(lengths.get(e.map or "", known.length)))
        for e in join(forward, backward[::-1])
    ]
    seconds = {key: there.seconds[key] + back.seconds[key] for key in there.seconds}
    places = back.places if back.is_stated.any() and not there.is_stated.any() else there.places
    return replace(there, estimates=in_order(joined), seconds=seconds, places=places)


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
        joined.append(refuted if contradicts else max(order, key=_says))
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


def _says(e: PoseEstimate) -> tuple[bool, bool, bool, float]:
    """How much an estimate says, to compare two."""
    probability = 0.0 if e.is_stated else e.probability
    return e.is_stated, e.status is LocalizerStatus.LOCALIZED, e.is_place_known, probability


def in_order(joined: Sequence[PoseEstimate]) -> list[PoseEstimate]:
    """Estimates of both directions in the log's: what is unstated is searched for up to the first pose, then lost."""
    first = next((n for n, e in enumerate(joined) if e.is_stated), len(joined))
    return [
        e if e.is_stated else replace(e, status=LocalizerStatus.SEARCHING if n < first else LocalizerStatus.LOST)
        for n, e in enumerate(joined)
    ]


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


def believed(
    estimates: Sequence[PoseEstimate], both: Mask, agree: Mask, steps: Scalars, tested: float
) -> list[PoseEstimate]:
    """Estimates in the direction of travel, those whose poses do not stand without these, and with the reason.

    ``steps``: path from the row before (m). Where both directions state poses and mostly disagree, one of the
    stretches is wrong, and nothing says which. One that ended within the path ``tested`` (m) counts up to where the
    other direction agrees; so does one that ended in a contradiction, or up to that path before its end if it had
    stood before that. Only path in the map counts.
    """
    walked = np.cumsum(np.where([e.status is LocalizerStatus.DEAD_RECKONING for e in estimates], 0.0, steps))
    found = list(estimates)
    for first, end in stretches(estimates):
        met, agreed, back = both[first:end], agree[first:end], walked[end - 1] - walked[first:end]
        # By what follows at once; a pose that only became too uncertain contradicts nothing.
        is_contradicted = end < len(estimates) and not estimates[end].is_place_known
        mostly_disagree = bool(met.any()) and agreed.sum() < 0.5 * met.sum()
        is_tested = back[0] >= tested and not is_contradicted
        stands = np.full(end - first, is_tested and not mostly_disagree)
        if agreed.any() and not is_tested:
            stands[: np.flatnonzero(agreed)[-1] + 1] = True
        # The contradiction began within the path by which a place is doubted; what stood before that still does.
        if is_contradicted and back[0] >= 2 * tested and not mostly_disagree:
            stands |= back >= tested
        for n in (first + np.flatnonzero(~stands)).tolist():
            if is_contradicted or mostly_disagree:
                found[n] = PoseEstimate(LocalizerStatus.LOST, REFUTED)
            else:
                words = untested_words(found[n].reason, tested)
                found[n] = PoseEstimate(LocalizerStatus.LOST, words, probability=found[n].probability)
    return found


def stretches(estimates: Sequence[PoseEstimate]) -> list[tuple[int, int]]:
    """First row and end of each stretch in which poses are stated, in one map."""
    groups = groupby(range(len(estimates)), lambda n: (estimates[n].is_stated, estimates[n].map))
    found = [list(rows) for (is_stated, _), rows in groups if is_stated]
    return [(rows[0], rows[-1] + 1) for rows in found]
