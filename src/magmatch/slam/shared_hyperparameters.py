# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters shared by all submaps, from short parts of the logs, since drift distorts long ones."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.cubes import even_choice
from magmatch.estimation.walk import BIN_LENGTH, bin_along_path, bin_means
from magmatch.field.choose_prior import likely_numbers
from magmatch.field.config import SPLINE
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.priors import PRIORS
from magmatch.geometry import ROUNDING, path_moved, path_walked
from magmatch.registration.prepared.prepared_map import correlation_length_of
from magmatch.slam.windows import PART_LENGTH

# Parts looked at, their length in lengthscales and most samples of each.
N_PARTS = 8
MOST_SAMPLES = 400
# Logs that are looked at: of more, the medians are known well enough, and each part costs as much as a window.
MOST_LOGS = 2 * N_PARTS
# Parts too long are cut so often at most: of noise alone the lengthscale falls for ever.
MOST_CUTS = 4
# What the prior expects is computed on a path of so many field lengths, at so many points, of samples with so much
# more noise that they say nothing.
TUBE_LENGTH, N_POINTS, SILENT = 6.0, 20, 1e5


def shared_hyperparameters(surveys: Sequence[Survey], n_parts: int = N_PARTS) -> tuple[Hyperparameters, float, float]:
    """Median hyperparameters of short parts, with an amplitude that holds for all, and median correlation length (m).

    The third is the mean squared gradient of all paths, noise included (`squared_gradient`).
    """
    found: list[Hyperparameters] = []
    lengths = []
    # Who stands sees nothing of how the field changes; where all stand, their jitter is their path.
    moved = [(survey, path) for survey in surveys if (path := path_moved(survey.positions))[-1] > 0]
    moved = moved or [(survey, path_walked(survey.positions)) for survey in surveys]
    moved = [moved[k] for k in even_choice(len(moved), MOST_LOGS)]
    n_each = max(n_parts // len(moved), 2)
    for survey, walked in moved:
        for middle in (np.arange(n_each) + 0.5) / n_each:
            # What the parts before showed is where the next begins: most fit at once.
            known = float(np.median([h.lengthscale for h in found])) if found else np.inf
            part = min(walked[-1] / N_PARTS, PART_LENGTH * known)
            for _ in range(MOST_CUTS):
                h, length = _hyperparameters_of(_part(survey, walked, middle, part))
                if part <= PART_LENGTH * h.lengthscale:
                    break
                part = PART_LENGTH * h.lengthscale
            found.append(h)
            lengths.append(length)
    names = [f.name for f in fields(Hyperparameters)]
    medians = {name: float(np.median([getattr(h, name) for h in found])) for name in names}
    # Nothing shorter than two steps between samples can be seen: of a robot that stands, jitter.
    steps = np.concatenate([np.linalg.norm(np.diff(s.positions, axis=0), axis=1) for s in surveys])
    length = max(float(np.median(lengths)), 2 * float(np.median(steps)))
    h = replace(found[0], **medians)
    return as_rough_as_measured(h, surveys, length), length, squared_gradient(surveys, length)


def as_rough_as_measured(h: Hyperparameters, surveys: Sequence[Survey], length: float) -> Hyperparameters:
    """Hyperparameters whose prior expects the squared gradient that is measured along the paths.

    The evidence of short parts takes neighbouring samples as correlated, and so finds an amplitude too small for what
    lies beside a path, where only the prior speaks: bases would be too sure of it by several times.
    """
    measured = squared_gradient(surveys, length, h.noise_sd)
    if measured <= 0:
        return h
    some = even_choice(len(surveys), MOST_LOGS)
    expected = float(np.median([_expected_square(surveys[k], h, TUBE_LENGTH * length) for k in some]))
    return replace(h, prior_scale=h.prior_scale * float(np.sqrt(measured / expected)))


def _expected_square(survey: Survey, h: Hyperparameters, length: float) -> float:
    """Mean square of an entry of the gradient in the middle part of a path, as the prior has it."""
    walked = path_walked(survey.positions)
    samples = _part(survey, walked, 0.5, min(walked[-1], length))
    # Of samples that say nothing, the posterior is the prior.
    silent = replace(h, noise_sd=SILENT * h.noise_sd)
    posterior = fit_posterior(samples, silent, SPLINE)
    C = posterior.covariance(samples.positions[even_choice(len(samples), N_POINTS)], order=1)[:, 3:, 3:]
    return float(np.diagonal(C, axis1=1, axis2=2).mean()) / h.inflation**2


def _part(survey: Survey, walked: np.ndarray, middle: float, length: float) -> Survey:
    """Some samples about the middle of a part of a path, in their principal frame."""
    center = np.clip(middle * walked[-1], length / 2, walked[-1] - length / 2)
    steps = np.linspace(center - length / 2, center + length / 2, MOST_SAMPLES)
    part = survey.subset(np.unique(np.searchsorted(walked, steps).clip(0, len(survey) - 1)))
    return part.transformed(part.principal_frame().inv())


def _hyperparameters_of(samples: Survey) -> tuple[Hyperparameters, float]:
    h = likely_numbers(PRIORS["spline"], samples, SPLINE)
    posterior = fit_posterior(samples, h, SPLINE)
    return h, correlation_length_of(posterior.evaluate(samples.positions, order=1))


def as_rough_as_here(h: Hyperparameters, everywhere: float, piece: Survey, length: float) -> Hyperparameters:
    """Hyperparameters of a submap: beside a calm path it expects a calm field, beside a rough one a rough one.

    ``everywhere``: the squared gradient of all paths. Noise is included in both, so that of a field too weak to be
    measured nothing is made.
    """
    here = squared_gradient([piece], length)
    if min(here, everywhere) <= ROUNDING * max(here, everywhere):
        return h
    return replace(h, prior_scale=h.prior_scale * float(np.sqrt(here / everywhere)))


def squared_gradient(surveys: Sequence[Survey], length: float, noise_sd: float = 0.0) -> float:
    """Mean square of an entry of the gradient along some paths, (T/m)^2, less what so much noise adds to it."""
    change2 = step2 = 0.0
    for survey in surveys:
        rows = bin_along_path(np.ascontiguousarray(survey.positions), BIN_LENGTH * length)
        x, b, n = bin_means(survey.positions, rows), bin_means(survey.field, rows), np.bincount(rows)
        # Bins next but one.
        noise2 = noise_sd**2 * (1 / n[2:] + 1 / n[:-2])
        change2 += float((((b[2:] - b[:-2]) ** 2).mean(axis=1) - noise2).sum())
        step2 += float(((x[2:] - x[:-2]) ** 2).sum())
    return change2 / step2 if step2 > 0 else 0.0
