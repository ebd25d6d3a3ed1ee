# SPDX-License-Identifier: BSD-3-Clause
"""Smoothing of a log: processed forward to its end and backward to its beginning.

At each pose, the two estimates use the path before it and the path after it. Their errors, above all the map's errors
there, are correlated in an unknown way, so they are fused by covariance intersection, which allows any correlation
(S. Julier and J. Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations, ACC 1997).
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import Estimate, LocalizerStatus
from magmatch.localization.known_places import Place
from magmatch.localization.localize import localize
from magmatch.localization.track import Track
from magmatch.progress import Progress

# Squared distance (chi^2 of six, one in 10,000) from which on two estimates contradict each other.
CONTRADICTION = 27.9


def smooth(
    place: Place, walk: Survey, config: LocalizerConfig | None = None, *, progress: Progress | None = None
) -> Track:
    """Localise a log in a map as `localize` does, using also the samples after each pose."""
    config = config or LocalizerConfig()
    there = localize(place, walk, config, progress=progress)
    back = localize(place, reversed_log(walk), config, progress=progress)
    joined = [_join(a, b) for a, b in zip(there.estimates, reversed(back.estimates), strict=True)]
    seconds = {key: there.seconds[key] + back.seconds[key] for key in there.seconds}
    return replace(there, estimates=joined, seconds=seconds)


def reversed_log(walk: Survey) -> Survey:
    """The same path walked backward."""
    times, R = walk.times, walk.orientations
    return replace(
        walk,
        positions=walk.positions[::-1],
        field=walk.field[::-1],
        times=None if times is None else -times[::-1],
        orientations=None if R is None else R[::-1],
    )


def _join(a: Estimate, b: Estimate) -> Estimate:
    """Fuse both estimates; if they contradict each other, state nothing."""
    if not (a.is_stated and b.is_stated):
        return a if a.is_stated else b if b.is_stated else max(a, b, key=lambda e: e.probability)
    T_map_a, T_map_b = a.T_map_body, b.T_map_body
    assert T_map_a is not None
    assert T_map_b is not None
    assert a.covariance is not None
    assert b.covariance is not None
    xi = (T_map_a.inv() * T_map_b).as_exp_coords()
    if a.map != b.map or xi @ np.linalg.solve(a.covariance + b.covariance, xi) > CONTRADICTION:
        return Estimate(LocalizerStatus.LOST, "the path before and the path behind contradict each other")
    # Both weigh one half.
    A, B = np.linalg.inv(a.covariance) / 2, np.linalg.inv(b.covariance) / 2
    C = np.linalg.inv(A + B)
    sure = max(a, b, key=lambda e: (e.status is LocalizerStatus.LOCALIZED, e.probability))
    T = T_map_a * RigidTransform.from_exp_coords(C @ B @ xi)
    return replace(sure, matrix=T.as_matrix(), covariance=(C + C.T) / 2)
