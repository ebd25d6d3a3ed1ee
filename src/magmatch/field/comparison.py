# SPDX-License-Identifier: BSD-3-Clause
"""Which prior predicts left-out parts of a survey best: what ``prior="auto"`` does.

The spline is preferred unless another is better by a clear margin: held-out errors are noisy, it follows what others
do not (magnets among the samples, walks of any length), and it costs least.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.errors import MagmatchError
from magmatch.field.config import FieldConfig
from magmatch.field.fit import declared_box
from magmatch.field.held_out import choose_part, typical_length
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import Parts, divide
from magmatch.field.linear_model import LinearModel
from magmatch.field.priors import PRIORS
from magmatch.typing import Scalars

log = logging.getLogger(__name__)

PREFERRED = "spline"
# Samples that the comparison uses; of a part of the survey, where most that would lose have lost already.
_N_COMPARED, _N_QUALIFYING = 2500, 800
# Another prior must miss by this share less (noise included, which no prior predicts, and which often is most of it),
# and by this many standard errors of the parts' mean.
_LEAST_GAIN, _LEAST_T = 0.005, 2.0
# Parts with fewer samples tell too little each; fewer parts are no sample of anything.
_FEWEST_IN_PART, _FEWEST_PARTS = 3, 6


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """A prior with its numbers, not yet calibrated, and how it does on each left-out part.

    Attributes
    ----------
    log_errors : (p,) array
        Logarithm of the root mean square error (T) of each part.
    fitted : tuple, optional
        Model laid over the samples that are compared, and the information in all of them.
    """

    name: str
    hyperparameters: Hyperparameters
    log_errors: Scalars
    fitted: tuple[LinearModel[Any], Any] | None = None

    @property
    def error(self) -> float:
        """Typical (geometric mean) error of a left-out part, T."""
        return float(np.exp(self.log_errors.mean()))


def choose_prior(
    samples: Survey, config: FieldConfig, T_domain_model: RigidTransform
) -> tuple[FieldConfig, Hyperparameters]:
    """Take the prior that predicts left-out parts best, and say by how much.

    Returns
    -------
    config : FieldConfig
        With the prior that was taken, and the held-out error of each in ``comparison``.
    hyperparameters : Hyperparameters
        Of that prior.
    """
    points, field = samples.positions, samples.field
    length = typical_length(points, field)
    parts = divide(points, length)
    names = [
        PREFERRED,
        *(name for name in sorted(PRIORS) if name != PREFERRED and _is_possible(name, samples, parts)),
    ]
    rivals: list[Rival] = []
    if len(samples) > 2 * _N_QUALIFYING and len(names) > 1:
        part = samples.subset(choose_part(points, _N_QUALIFYING, 3))
        rivals = _compared(names, part, divide(part.positions, length), config, T_domain_model)
        names = [PREFERRED, *(rival.name for rival in rivals[1:] if _may_be_better(rival, rivals[0]))]
    if len(names) > 1 or not rivals:
        rivals = _compared(names, samples, parts, config, T_domain_model)
        if _is_undecided(rivals):
            rivals = _compared_further(rivals, samples, parts)
        taken = _best(rivals)
    else:
        named = config.model_copy(update={"prior": PREFERRED})
        h = resolved_hyperparameters(samples, named, T_domain_model)
        taken = replace(rivals[0], hyperparameters=h, fitted=None)
    comparison = {rival.name: rival.error for rival in rivals if len(rival.log_errors)}
    _tell(taken, comparison)
    config = config.model_copy(update={"prior": taken.name, "comparison": comparison})
    box = declared_box(config, T_domain_model)
    model = taken.fitted[0] if taken.fitted is not None and len(samples) <= _N_COMPARED else None
    h = PRIORS[taken.name].calibrated(points, field, taken.hyperparameters, box, model)
    return config, replace(h, **_given(config))


def resolved_hyperparameters(
    samples: Survey, config: FieldConfig, T_domain_model: RigidTransform, calibrate: bool = True
) -> Hyperparameters:
    """Numbers from the configuration where given, from the data otherwise."""
    log.info("choosing hyperparameters of prior %s", config.prior)
    box = declared_box(config, T_domain_model)
    chosen = PRIORS[config.prior].choose_hyperparameters(samples.positions, samples.field, box, calibrate)
    return replace(chosen, **_given(config))


def _given(config: FieldConfig) -> dict[str, float]:
    """Numbers that are not left to the data."""
    names = ("lengthscale", "signal_sd", "noise_sd", "spacing")
    return {name: getattr(config, name) for name in names if getattr(config, name) is not None}


def _is_possible(name: str, samples: Survey, parts: Parts) -> bool:
    """Whether a prior can be compared and afforded."""
    if parts.folds and PRIORS[name].is_affordable(samples.positions, samples.field):
        return True
    log.info("prior %s is not compared: too few samples to leave any out, or too wide a survey", name)
    return False


def _compared(
    names: list[str], samples: Survey, parts: Parts, config: FieldConfig, T_domain_model: RigidTransform
) -> list[Rival]:
    """How priors do on the same samples, the preferred one first and always."""
    few, thinned, rivals = *_thinned(samples, parts), []
    for name in names:
        named = config.model_copy(update={"prior": name})
        try:
            h = resolved_hyperparameters(samples, named, T_domain_model, calibrate=False)
            # Laid over all samples: what is compared is the field between them, not how far each basis reaches.
            box = declared_box(named, T_domain_model)
            model = PRIORS[name].build(few.positions, few.field, h, box)
            everything = model.observe(few.positions, few.field)
            rivals.append(Rival(name, h, _log_errors(few, thinned, model, everything), (model, everything)))
        except (MagmatchError, ValueError, np.linalg.LinAlgError) as error:
            if name == PREFERRED:
                raise
            log.info("prior %s is not compared: %s", name, error)
    return rivals


def _compared_further(rivals: list[Rival], samples: Survey, parts: Parts) -> list[Rival]:
    """The preferred prior and those that may yet beat it, on all parts of the survey instead of some."""
    few, rest = _thinned(samples, replace(parts, folds=parts.rest))
    out = []
    for rival in (rivals[0], *(other for other in rivals[1:] if _may_be_better(other, rivals[0]))):
        assert rival.fitted is not None  # it was compared
        errors = _log_errors(few, rest, *rival.fitted)
        out.append(replace(rival, log_errors=np.concatenate([rival.log_errors, errors])))
    return out


def _thinned(samples: Survey, parts: Parts) -> tuple[Survey, Parts]:
    """As many samples as a comparison uses."""
    some = np.arange(0, len(samples), -(-len(samples) // _N_COMPARED))
    folds = tuple(fold[some] for fold in parts.folds)
    return samples.subset(some), Parts(parts.number[some], folds, parts.is_path)


def _log_errors(samples: Survey, parts: Parts, model: LinearModel[Any], everything: Any) -> Scalars:
    """Logarithm of the error of each left-out part that holds enough samples."""
    points, field, out = samples.positions, samples.field, []
    for fold in parts.folds:
        posterior = model.infer(everything - model.observe(points[fold], field[fold]))
        square = ((posterior.evaluate(points[fold]).field - field[fold]) ** 2).sum(axis=1)
        number = parts.number[fold]
        count = np.bincount(number)
        mean = np.bincount(number, weights=square)[count >= _FEWEST_IN_PART] / count[count >= _FEWEST_IN_PART]
        # What was fitted exactly must not weigh infinitely.
        out.append(0.5 * np.log(np.maximum(mean, 1e-24)))
    return np.concatenate([np.zeros(0), *out])


def _best(rivals: list[Rival]) -> Rival:
    """The preferred prior, unless others are clearly better: then the best of those."""
    preferred = rivals[0]
    better = [rival for rival in rivals[1:] if _is_clearly_better(rival, preferred)]
    return min(better, key=lambda rival: rival.error, default=preferred)


def _is_clearly_better(rival: Rival, preferred: Rival) -> bool:
    gain = preferred.log_errors - rival.log_errors
    if len(gain) < _FEWEST_PARTS:
        return False
    standard_error = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return bool(gain.mean() > max(_LEAST_GAIN, _LEAST_T * standard_error))


def _is_undecided(rivals: list[Rival]) -> bool:
    """Whether a rival is ahead of all that would be taken, but not clearly ahead of the preferred one."""
    taken = _best(rivals)
    ahead = (rival for rival in rivals if len(rival.log_errors) > 0 and rival.error < taken.error)
    return any(not _is_clearly_better(rival, rivals[0]) for rival in ahead)


def _may_be_better(rival: Rival, preferred: Rival) -> bool:
    """Whether a rival does not lose by more than chance on few samples."""
    gain = preferred.log_errors - rival.log_errors
    if len(gain) < _FEWEST_PARTS:
        return True
    return bool(gain.mean() + gain.std(ddof=1) / np.sqrt(len(gain)) > 0)


def _tell(taken: Rival, comparison: Mapping[str, float]) -> None:
    errors = ", ".join(f"{name} {error:.3g} T" for name, error in comparison.items())
    log.info("prior %s taken; typical error of left-out parts: %s", taken.name, errors or "not compared")
