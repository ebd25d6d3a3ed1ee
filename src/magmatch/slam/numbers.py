# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters shared by all stretches, from short parts of the logs, since drift distorts long ones."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.prior_choice.numbers import likely_numbers
from magmatch.field.priors import PRIORS
from magmatch.geometry import path_walked
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.pose_prior import ATTITUDE_SD
from magmatch.registration.prepared.prepared_map import correlation_length_of

# Parts looked at, their length in lengthscales and most samples of each.
N_PARTS = 8
PART_LENGTH = 25.0
MOST_SAMPLES = 400
# Parts too long are cut so often at most: of noise alone the lengthscale falls for ever.
MOST_CUTS = 4


def shared_numbers(surveys: Sequence[Survey]) -> tuple[Hyperparameters, float]:
    """Median numbers of short parts, and their median correlation length (m)."""
    found: list[Hyperparameters] = []
    lengths = []
    n_parts = max(N_PARTS // len(surveys), 2)
    for survey in surveys:
        walked = path_walked(survey.positions)
        for middle in (np.arange(n_parts) + 0.5) / n_parts:
            # What the parts before showed is where the next begins: most fit at once.
            known = float(np.median([h.lengthscale for h in found])) if found else np.inf
            part = min(walked[-1] / N_PARTS, PART_LENGTH * known)
            for _ in range(MOST_CUTS):
                numbers, length = _numbers_of(_part(survey, walked, middle, part))
                if part <= PART_LENGTH * numbers.lengthscale:
                    break
                part = PART_LENGTH * numbers.lengthscale
            found.append(numbers)
            lengths.append(length)
    names = [f.name for f in fields(Hyperparameters)]
    medians = {name: float(np.median([getattr(h, name) for h in found])) for name in names}
    # Nothing shorter than two steps between samples can be seen: of a robot that stands, jitter.
    steps = np.concatenate([np.linalg.norm(np.diff(s.positions, axis=0), axis=1) for s in surveys])
    return replace(found[0], **medians), max(float(np.median(lengths)), 2 * float(np.median(steps)))


def guessed_noise(numbers: Hyperparameters, length: float) -> PathNoise:
    """Guess of the field that does not repeat from walk to walk, before any two were compared."""
    return PathNoise(
        misfit_sd=0.25 * numbers.signal_sd,
        misfit_length=length,
        nugget_sd=0.25 * numbers.noise_sd,
        constant_sd=0.1 * numbers.signal_sd,
        map_factor=1.0,
        map_length=length,
        attitude_sd=ATTITUDE_SD,
        drift_sd=0.02 * length,
        drift_length=4 * length,
    )


def _part(survey: Survey, walked: np.ndarray, middle: float, length: float) -> Survey:
    center = np.clip(middle * walked[-1], length / 2, walked[-1] - length / 2)
    steps = np.linspace(center - length / 2, center + length / 2, MOST_SAMPLES)
    return survey.subset(np.unique(np.searchsorted(walked, steps).clip(0, len(survey) - 1)))


def _numbers_of(part: Survey) -> tuple[Hyperparameters, float]:
    samples = part.transformed(part.principal_frame().inv())
    numbers = likely_numbers(PRIORS["spline"], samples, FieldConfig())
    posterior = fit_posterior(samples, numbers, FieldConfig())
    return numbers, correlation_length_of(posterior.evaluate(samples.positions, order=1))
