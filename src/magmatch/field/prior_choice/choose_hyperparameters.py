# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of a prior: from the configuration if given, from the data otherwise."""

import logging
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.errors import MagmatchError
from magmatch.field.config import FieldConfig
from magmatch.field.domain import Box
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.calibration import calibrated
from magmatch.field.linear_model import Prior
from magmatch.field.priors import prior_over
from magmatch.progress import tell

log = logging.getLogger(__name__)

# Of a prior that a survey does not suit.
FAILURES = (MagmatchError, ValueError, np.linalg.LinAlgError)


def choose_numbers(prior: Prior, samples: Survey, config: FieldConfig) -> Hyperparameters:
    """Numbers whose noise and spread hold for held-out samples."""
    h = likely_numbers(prior, samples, FieldConfig())
    return replace(calibrated(prior, samples.positions, samples.field, h), **given_numbers(config))


def choose_all_numbers(
    names: Iterable[str], samples: Survey, config: FieldConfig, box: Box | None
) -> dict[str, Hyperparameters]:
    """Numbers of several priors, those that fail left out; the first one must be possible."""
    found: dict[str, Hyperparameters] = {}
    for name in names:
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
