# SPDX-License-Identifier: BSD-3-Clause
"""Errors of priors on held-out parts of the same survey."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.domain import Box
from magmatch.field.folds import Folds
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import LinearModel
from magmatch.field.prior_choice.choose_hyperparameters import FAILURES
from magmatch.field.priors import prior_over
from magmatch.progress import tell
from magmatch.typing import Indices, Mask, Scalars

log = logging.getLogger(__name__)

# Samples that are compared; parts with fewer tell too little each.
N_COMPARED, _FEWEST_IN_PART = 2500, 3


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


def compare_on_the_rest(candidates: list[PriorCandidate], samples: Survey, folds: Folds) -> list[PriorCandidate]:
    """Compare the errors of all parts of the survey instead of some."""
    few, left_out, part = _thinned(samples, folds, folds.rest)
    out = []
    for candidate in candidates:
        assert candidate.fitted is not None  # it was compared
        errors = _log_errors(few, left_out, part, *candidate.fitted)
        out.append(replace(candidate, log_errors=np.concatenate([candidate.log_errors, errors])))
    return out


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
