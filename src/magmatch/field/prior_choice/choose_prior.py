# SPDX-License-Identifier: BSD-3-Clause
"""Choose the prior that predicts held-out parts of a survey best: ``prior="auto"``.

The spline is preferred unless another is clearly better: held-out errors are noisy, and the spline represents what
others do not (magnets among the samples, walks of any length) and costs least.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.excess import excess
from magmatch.field.folds import Folds, divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated
from magmatch.field.prior_choice.choose_hyperparameters import choose_all_numbers, given_numbers
from magmatch.field.prior_choice.cross_validation import N_COMPARED, PriorCandidate, compare, compare_on_the_rest
from magmatch.field.priors import DENSE_PRIORS, prior_over
from magmatch.field.subset import choose_part
from magmatch.field.variogram import typical_length

log = logging.getLogger(__name__)

PREFERRED = "spline"
# Samples of a first round, for large surveys along paths: most that would lose on all of it have lost already. They
# are thinned from more, in a few places far apart, since it is by its stretches that priors are told apart. In a
# volume a part tells too little: there priors differ by how they fill it.
_N_QUALIFYING, _N_AROUND, _N_PLACES = 800, 4800, 8
# Another prior must miss by this share less (noise included, which no prior predicts, and which often is most of it),
# and by this many standard errors of the parts' mean.
LEAST_GAIN, LEAST_T = 0.005, 2.0
# Fewer parts are no sample of anything.
FEWEST_PARTS = 6


def choose_prior(
    samples: Survey, config: FieldConfig, T_domain_model: RigidTransform
) -> tuple[FieldConfig, Hyperparameters]:
    """Choose the prior that predicts held-out parts best, and its numbers; ``comparison`` stores each one's error."""
    box = Box.declared(config.domain, T_domain_model)
    length = typical_length(samples.positions, samples.field)
    folds = divide(samples.positions, length)
    names = [PREFERRED, *(name for name in sorted(DENSE_PRIORS) if _is_possible(name, samples, folds))]
    # Chosen once, from all samples: a part would not show what a prior cannot afford to represent on the whole.
    known = choose_all_numbers(names, samples, config, box)
    taken, compared = PriorCandidate(PREFERRED, known[PREFERRED], np.zeros(0)), []
    if len(known) > 1 and folds.is_path and len(samples) > 2 * _N_QUALIFYING:
        part = _qualifying(samples)
        compared = compare(known, part, divide(part.positions, length), box)
        ahead = (other.name for other in compared[1:] if lead(other, compared[0]) > 1)
        known = {name: known[name] for name in (PREFERRED, *ahead)}
    if len(known) > 1:
        compared = compare(known, samples, folds, box)
        if is_undecided(compared):
            close = [other for other in compared[1:] if lead(other, compared[0]) > -1]
            compared = compare_on_the_rest([compared[0], *close], samples, folds)
        taken = best_possible(compared, samples)
    errors = {candidate.name: candidate.error for candidate in compared if len(candidate.log_errors)}
    told = ", ".join(f"{name} {error:.3g} T" for name, error in errors.items())
    log.info("prior %s taken; typical error of left-out parts: %s", taken.name, told or "not compared")
    model = taken.fitted[0] if taken.fitted is not None and len(samples) <= N_COMPARED else None
    h = calibrated(prior_over(taken.name, box), samples.positions, samples.field, taken.hyperparameters, model)
    return config.model_copy(update={"prior": taken.name, "comparison": errors}), replace(h, **given_numbers(config))


def _qualifying(samples: Survey) -> Survey:
    """The samples of a first round."""
    rows = np.flatnonzero(choose_part(samples.positions, _N_AROUND, _N_PLACES))
    return samples.subset(rows[:: -(-len(rows) // _N_QUALIFYING)])


def _is_possible(name: str, samples: Survey, folds: Folds) -> bool:
    """Whether a prior can be compared and afforded."""
    if folds.left_out and DENSE_PRIORS[name].is_affordable(samples.positions, samples.field):
        return True
    log.info("prior %s is not compared: too few samples to leave any out, or too wide a survey", name)
    return False


def best(candidates: list[PriorCandidate]) -> PriorCandidate:
    """The preferred prior, unless others are clearly better: then the best of those."""
    preferred = candidates[0]
    better = [other for other in candidates[1:] if _is_clearly_better(other, preferred)]
    return min(better, key=lambda candidate: candidate.error, default=preferred)


def best_possible(candidates: list[PriorCandidate], samples: Survey) -> PriorCandidate:
    """The best one whose field is possible; what predicts held-out stretches may be absurd beside all of them."""
    while (taken := best(candidates)) is not candidates[0] and taken.fitted is not None:
        model, everything = taken.fitted
        words = excess(model.infer(everything), samples)
        if not words:
            break
        log.warning("%s: prior %s is out of the choice: its field %s", samples.name, taken.name, words)
        candidates = [other for other in candidates if other is not taken]
    return taken


def is_undecided(candidates: list[PriorCandidate]) -> bool:
    """Whether one is ahead of all that would be taken, but not clearly ahead of the preferred one."""
    taken = best(candidates)
    ahead = (other for other in candidates if len(other.log_errors) > 0 and other.error < taken.error)
    return any(not _is_clearly_better(other, candidates[0]) for other in ahead)


def lead(other: PriorCandidate, preferred: PriorCandidate) -> float:
    """By how many standard errors of the parts' mean a prior is ahead; infinite where too few parts tell nothing."""
    gain = preferred.log_errors - other.log_errors
    if len(gain) < FEWEST_PARTS:
        return np.inf
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), np.finfo(float).tiny))


def _is_clearly_better(other: PriorCandidate, preferred: PriorCandidate) -> bool:
    gain = preferred.log_errors - other.log_errors
    return len(gain) >= FEWEST_PARTS and gain.mean() > LEAST_GAIN and lead(other, preferred) > LEAST_T
