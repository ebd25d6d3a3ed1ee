# SPDX-License-Identifier: BSD-3-Clause
"""Neighbouring windows support each other: the forward-backward algorithm over the poses of a log's windows.

The states of a window are its candidate poses and "nowhere among what was searched". A candidate that follows from
the previous one by odometry gains the ratio of odometry's predicted density to that of the prior.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from magmatch.slam.search.loop_closure import Match
from magmatch.typing import Matrix, Scalars


def smooth(
    windows: Sequence[Sequence[Match]], log_transitions: list[Matrix], revisits: Sequence[float], keeps_on: float
) -> list[Scalars]:
    """Probability of each candidate pose of each window; the remainder to one is that of nowhere.

    ``log_transitions`` (a, b) between neighbouring windows: log density of b's pose as odometry predicts it from a's;
    ``revisits``: for each window, the share of such windows that lie somewhere; ``keeps_on``: of windows that do,
    the share whose next window does too.
    """
    leaves = 1 - keeps_on
    forward: list[Scalars] = []
    steps = []
    for k, (states, revisit) in enumerate(zip(windows, revisits, strict=True)):
        # As many as leave; where a window is known to lie somewhere, whatever the one before did.
        enters = min(leaves * revisit / (1 - revisit), revisit)
        own = np.array([0.0, *(s.log_odds - s.log_prior for s in states)])
        prior = np.array([s.log_prior for s in states])
        if k == 0:
            start = np.concatenate([[np.log(1 - revisit)], np.log(revisit) + prior])
            forward.append(start + own)
            continue
        before = windows[k - 1]
        M = np.full((len(before) + 1, len(states) + 1), np.log(leaves))
        M[0, 0] = np.log1p(-enters)
        M[0, 1:] = np.log(enters) + prior
        if before and states:
            # Odometry may fail as well: a window may leave one place for another.
            M[1:, 1:] = np.logaddexp(np.log(keeps_on) + log_transitions[k - 1], np.log(leaves * revisit) + prior)
        steps.append((M, own))
        forward.append(logsumexp(forward[-1][:, None] + M, axis=0) + own)
    found = [np.zeros(0)] * len(windows)
    backward = np.zeros(len(windows[-1]) + 1) if windows else np.zeros(1)
    for k in range(len(windows) - 1, -1, -1):
        log_p = forward[k] + backward
        found[k] = np.exp(log_p - logsumexp(log_p))[1:]
        if k:
            M, own = steps[k - 1]
            backward = logsumexp(M + (own + backward)[None, :], axis=1)
    return found
