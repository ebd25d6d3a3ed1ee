# SPDX-License-Identifier: BSD-3-Clause
"""Choose the prior that predicts held-out parts of a survey best: ``prior="auto"``.

The spline is preferred unless another is clearly better: held-out errors are noisy, and the spline represents what
others do not (magnets among the samples, walks of any length) and costs least.
"""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.errors import MagmatchError
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.excess import excess
from magmatch.field.folds import Folds, divide
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated
from magmatch.field.linear_model import LinearModel, Prior
from magmatch.field.priors import DENSE_PRIORS, prior_over
from magmatch.field.subset import choose_part
from magmatch.field.variogram import typical_length
from magmatch.progress import tell
from magmatch.typing import Indices, Mask, Scalars

log = logging.getLogger(__name__)

# Of a prior that a survey does not suit.
FAILURES = (MagmatchError, ValueError, np.linalg.LinAlgError)
# Samples that are compared; parts with fewer tell too little each.
N_COMPARED, _FEWEST_IN_PART = 2500, 3
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
    samples: Survey, config: FieldConfig, T_domain_model: RigidTransform, preferred: Hyperparameters | None = None
) -> tuple[FieldConfig, Hyperparameters]:
    """Choose the prior that predicts held-out parts best, and its numbers; ``comparison`` stores each one's error.

    ``preferred``: the numbers of the preferred prior, where they were chosen already.
    """
    box = Box.declared(config.domain, T_domain_model)
    length = typical_length(samples.positions, samples.field)
    folds = divide(samples.positions, length)
    names = [PREFERRED, *(name for name in sorted(DENSE_PRIORS) if _is_possible(name, samples, folds, length))]
    # Chosen once, from all samples: a part would not show what a prior cannot afford to represent on the whole.
    known = choose_all_numbers(names, samples, config, box, {} if preferred is None else {PREFERRED: preferred})
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


def _is_possible(name: str, samples: Survey, folds: Folds, length: float) -> bool:
    """Whether a prior can be compared and afforded."""
    if folds.left_out and DENSE_PRIORS[name].is_affordable(samples.positions, length):
        return True
    log.info("prior %s is not compared: too few samples to leave any out, or too wide a survey", name)
    return False


def choose_all_numbers(
    names: Iterable[str],
    samples: Survey,
    config: FieldConfig,
    box: Box | None,
    chosen: Mapping[str, Hyperparameters],
) -> dict[str, Hyperparameters]:
    """Numbers of several priors beside those chosen, those that fail left out; the first one must be possible."""
    found = {name: replace(h, **given_numbers(config)) for name, h in chosen.items()}
    for name in (name for name in names if name not in chosen):
        try:
            found[name] = likely_numbers(prior_over(name, box), samples, config)
        except FAILURES as error:
            if not found:
                raise
            log.info("prior %s is not compared: %s", name, error)
    return found


def likely_numbers(prior: Prior, samples: Survey, config: FieldConfig) -> Hyperparameters:
    """Numbers that fit the data, which suffices for the mean."""
    tell(f"choosing hyperparameters of prior {prior.name}")
    return replace(prior.choose_hyperparameters(samples.positions, samples.field), **given_numbers(config))


def given_numbers(config: FieldConfig) -> dict[str, float]:
    """Numbers given in the configuration."""
    names = ("lengthscale", "signal_sd", "noise_sd", "spacing")
    return {name: getattr(config, name) for name in names if getattr(config, name) is not None}


@dataclass(frozen=True, eq=False, slots=True)
class PriorCandidate:
    """A prior with its numbers, not yet calibrated, and the logarithm of its rms error (T) on each held-out part.

    ``fitted``: its model over the samples that are compared, and the information in all of them.
    """

    name: str
    hyperparameters: Hyperparameters
    log_errors: Scalars
    fitted: tuple[LinearModel, Any] | None = None

    @property
    def error(self) -> float:
        """Typical (geometric mean) error on a held-out part, T."""
        return float(np.exp(self.log_errors.mean()))


def _qualifying(samples: Survey) -> Survey:
    """The samples of a first round."""
    rows = np.flatnonzero(choose_part(samples.positions, _N_AROUND, _N_PLACES))
    return samples.subset(rows[:: -(-len(rows) // _N_QUALIFYING)])


def compare(
    numbers: Mapping[str, Hyperparameters], samples: Survey, folds: Folds, box: Box | None
) -> list[PriorCandidate]:
    """How priors with these numbers do on the same samples; the first one must be possible, others may fail."""
    few, left_out, part = _thinned(samples, folds, folds.left_out)
    compared: list[PriorCandidate] = []
    for k, (name, h) in enumerate(numbers.items()):
        tell(f"comparing prior {name}", k / len(numbers))
        try:
            # Laid over all samples: what is compared is the field between them, not how far each basis reaches.
            model = prior_over(name, box).build(few.positions, few.field, h)
            everything = model.observe(few.positions, few.field)
            errors = _log_errors(few, left_out, part, model, everything)
        except FAILURES as error:
            if not compared:
                raise
            log.info("prior %s is not compared: %s", name, error)
        else:
            compared.append(PriorCandidate(name, h, errors, (model, everything)))
    return compared


def _thinned(samples: Survey, folds: Folds, left_out: tuple[Mask, ...]) -> tuple[Survey, list[Mask], Indices]:
    """Take as many samples as a comparison uses, which of them to leave out at a time, and their parts."""
    some = np.arange(0, len(samples), -(-len(samples) // N_COMPARED))
    return samples.subset(some), [fold[some] for fold in left_out], folds.part[some]


def _log_errors(samples: Survey, left_out: list[Mask], part: Indices, model: LinearModel, everything: Any) -> Scalars:
    """Logarithm of the error of each left-out part that holds enough samples."""
    points, field, out = samples.positions, samples.field, []
    for fold in left_out:
        posterior = model.infer(everything - model.observe(points[fold], field[fold]))
        square = ((posterior.evaluate(points[fold]).field - field[fold]) ** 2).sum(axis=1)
        count = np.bincount(part[fold])
        is_told = count >= _FEWEST_IN_PART
        mean = np.bincount(part[fold], weights=square)[is_told] / count[is_told]
        # What was fitted exactly must not weigh infinitely.
        out.append(0.5 * np.log(np.maximum(mean, 1e-24)))
    return np.concatenate([np.zeros(0), *out])


def lead(other: PriorCandidate, preferred: PriorCandidate) -> float:
    """By how many standard errors of the parts' mean a prior is ahead; infinite where too few parts tell nothing."""
    gain = preferred.log_errors - other.log_errors
    if len(gain) < FEWEST_PARTS:
        return np.inf
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), np.finfo(float).tiny))


def is_undecided(candidates: list[PriorCandidate]) -> bool:
    """Whether one is ahead of all that would be taken, but not clearly ahead of the preferred one."""
    taken = best(candidates)
    ahead = (other for other in candidates if len(other.log_errors) > 0 and other.error < taken.error)
    return any(not _is_clearly_better(other, candidates[0]) for other in ahead)


def best(candidates: list[PriorCandidate]) -> PriorCandidate:
    """The preferred prior, unless others are clearly better: then the best of those."""
    preferred = candidates[0]
    better = [other for other in candidates[1:] if _is_clearly_better(other, preferred)]
    return min(better, key=lambda candidate: candidate.error, default=preferred)


def _is_clearly_better(other: PriorCandidate, preferred: PriorCandidate) -> bool:
    gain = preferred.log_errors - other.log_errors
    return len(gain) >= FEWEST_PARTS and gain.mean() > LEAST_GAIN and lead(other, preferred) > LEAST_T


def compare_on_the_rest(candidates: list[PriorCandidate], samples: Survey, folds: Folds) -> list[PriorCandidate]:
    """Compare the errors of all parts of the survey instead of some."""
    few, left_out, part = _thinned(samples, folds, folds.rest)
    out = []
    for candidate in candidates:
        assert candidate.fitted is not None  # it was compared
        errors = _log_errors(few, left_out, part, *candidate.fitted)
        out.append(replace(candidate, log_errors=np.concatenate([candidate.log_errors, errors])))
    return out


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


def choose_numbers(prior: Prior, samples: Survey, config: FieldConfig) -> Hyperparameters:
    """Numbers whose noise and spread hold for held-out samples."""
    h = likely_numbers(prior, samples, FieldConfig())
    return replace(calibrated(prior, samples.positions, samples.field, h), **given_numbers(config))
