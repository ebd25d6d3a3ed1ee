# SPDX-License-Identifier: BSD-3-Clause
"""The choice among several priors by their errors on the same held-out parts; the preferred one comes first."""

import numpy as np

from magmatch.field.prior_choice.cross_validation import Candidate

# Another prior must miss by this share less (noise included, which no prior predicts, and which often is most of it),
# and by this many standard errors of the parts' mean.
LEAST_GAIN, LEAST_T = 0.005, 2.0
# Fewer parts are no sample of anything.
FEWEST_PARTS = 6


def best(candidates: list[Candidate]) -> Candidate:
    """The preferred prior, unless others are clearly better: then the best of those."""
    preferred = candidates[0]
    better = [other for other in candidates[1:] if _is_clearly_better(other, preferred)]
    return min(better, key=lambda candidate: candidate.error, default=preferred)


def is_undecided(candidates: list[Candidate]) -> bool:
    """Whether one is ahead of all that would be taken, but not clearly ahead of the preferred one."""
    taken = best(candidates)
    ahead = (other for other in candidates if len(other.log_errors) > 0 and other.error < taken.error)
    return any(not _is_clearly_better(other, candidates[0]) for other in ahead)


def lead(other: Candidate, preferred: Candidate) -> float:
    """By how many standard errors of the parts' mean a prior is ahead; infinite where too few parts tell nothing."""
    gain = preferred.log_errors - other.log_errors
    if len(gain) < FEWEST_PARTS:
        return np.inf
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), np.finfo(float).tiny))


def _is_clearly_better(other: Candidate, preferred: Candidate) -> bool:
    gain = preferred.log_errors - other.log_errors
    return len(gain) >= FEWEST_PARTS and gain.mean() > LEAST_GAIN and lead(other, preferred) > LEAST_T
