# SPDX-License-Identifier: BSD-3-Clause
"""The covariance of another walk's residuals against a map, learned from held-out stretches of the map.

Along a path the residuals of a right pose are strongly correlated: the map's error, moved iron and drifting poses
extend over metres. Stretches of the base survey are held out and predicted from the rest, and the parameters of the
residuals' covariance maximise the likelihood under a weak prior, near which they stay if the base never passes a
place twice.
"""

from collections.abc import Collection
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtri

from magmatch.data.survey import Survey
from magmatch.estimation.cubes import SAMPLING, even_choice
from magmatch.estimation.limits import FEW_POINTS, N_DRAWS
from magmatch.estimation.pose_prior import ATTITUDE_SD
from magmatch.estimation.walk import MIN_BINS, bin_along_path, bin_means
from magmatch.field.fit import fit_posterior
from magmatch.field.folds import folds_of
from magmatch.field.map import FieldMap
from magmatch.geometry import path_walked, skew
from magmatch.progress import tell
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Tensors, Vectors

# Length of a held-out stretch of the base's path in correlation lengths; each held-out set takes a refit.
STRETCH_LENGTH = 5.0
# Prior spread (natural log) of the parameters about their guesses, and of one walk's covariance about another's; and
# the number of stretches that the guess of the latter counts as.
LOG_SD = 0.5
PRIOR_STRETCHES = 5
# Guess of the drift of positions in localisation, field lengths: the mean of what could be learned (CEA, InfCenter,
# the museum's routes 1 to 3: 0.05 to 0.18). From much less the likelihood, flat near none, never leads to it.
DRIFT = 0.08
# Where the search for parameters ends (natural log, about the guesses): what the prior leaves beyond is none but
# rounding, and covariances would be singular.
FARTHEST = -LOG_SD * float(ndtri(np.finfo(float).eps))


@dataclass(frozen=True, slots=True)
class PathNoise:
    """Covariance of the residuals along a path, in addition to the map's own."""

    # T and m: correlated part, ``sd^2 exp(-d / length)``, or if it is smooth a Matern-3/2 process of this lengthscale
    misfit_sd: float
    misfit_length: float
    nugget_sd: float  # T: independent part of each bin
    constant_sd: float  # T: constant of the whole walk
    map_factor: float  # on the map's own standard deviation
    map_length: float  # m: correlation length of the map's error, ``exp(-d^2 / 2 length^2)``
    attitude_sd: float  # rad: error of the orientations that turned the field, correlated like the drift
    drift_sd: float  # m: error of positions along the path, through the field's gradient: ``sd^2 exp(-d / length)``
    drift_length: float  # m
    spread: float = LOG_SD  # standard deviation, between walks, of the logarithm of the covariance's common factor
    n_stretches: int = 0  # number of held-out stretches that it was learned from
    is_smooth: bool = False  # whether the correlated part is

    @classmethod
    def guess(
        cls, length: float, misfit_sd: float, nugget_sd: float, constant_sd: float, pose_sd: float = 0.0
    ) -> "PathNoise":
        """Guess the rest by the field's correlation length (m); positions are as accurate as stated, or 2 % of it."""
        drift_sd = max(pose_sd, 0.02 * length)
        return cls(misfit_sd, length, nugget_sd, constant_sd, 1.0, length, ATTITUDE_SD, drift_sd, 4 * length)

    @property
    def is_learned(self) -> bool:
        """Whether it was learned from the base; otherwise it is a guess."""
        return self.n_stretches >= PRIOR_STRETCHES

    @property
    def drift_rate(self) -> float:
        """Rate at which each of two walks drifts, at first, m/sqrt(m)."""
        return float(self.drift_sd / np.sqrt(self.drift_length))

    @property
    def total_sd(self) -> float:
        """Standard deviation of one component between two walks through one place, without drift, T."""
        return float(np.sqrt(self.misfit_sd**2 + self.nugget_sd**2 + self.constant_sd**2))

    def factor(self, chi2: Scalars | float, n_free: Scalars | float) -> tuple[Scalars, Scalars]:
        """Factor on the covariance that explains each walk best, given how walks differ; and log likelihoods.

        These are, in nats, ``-chi2 / 2 k - n/2 ln k``, averaged over the factor k, whose logarithm is normal with the
        spread.
        """
        log_factor, log_prior = self.log_factors()
        chi2, n_free = np.asarray(chi2)[..., None], np.asarray(n_free)[..., None]
        found = -0.5 * chi2 * np.exp(-log_factor) - 0.5 * n_free * log_factor + log_prior
        return np.exp(log_factor[found.argmax(axis=-1)]), np.logaddexp.reduce(found, axis=-1)

    def log_factors(self) -> tuple[Scalars, Scalars]:
        """Logarithms of the covariance's factors that are averaged over, and of their probabilities."""
        return _log_factors(self.spread)

    def isotropic(self, distance: Matrix, map_sd: Scalars) -> Matrix:
        """Covariance of one component: all but the drift; (..., n, n), T^2."""
        x = (np.sqrt(3) if self.is_smooth else 1.0) * distance / self.misfit_length
        along = self.misfit_sd**2 * ((1 + x) * np.exp(-x) if self.is_smooth else np.exp(-x)) + self.constant_sd**2
        map_along, map_sd = np.exp(-0.5 * (distance / self.map_length) ** 2), self.map_factor * map_sd
        C = along + map_sd[..., :, None] * map_sd[..., None, :] * map_along
        C = C + self.nugget_sd**2 * np.eye(distance.shape[-1])
        return np.asarray(C)

    def full(self, distance: Matrix, map_sd: Scalars, gradient: Tensors, field: Vectors) -> Matrix:
        """Covariance of all components, rows ordered bin by bin: (..., 3 n, 3 n), T^2."""
        n = distance.shape[-1]
        turns = skew(field.reshape(-1, 3)).reshape(*field.shape, 3)
        # A shift and a rotation of the walker's frame both change the field linearly: one matrix per bin.
        moves = np.concatenate([self.drift_sd * gradient, self.attitude_sd * turns], axis=-1)
        flat = moves.reshape(*moves.shape[:-3], 3 * n, 6)
        C = flat @ np.swapaxes(flat, -1, -2)
        # By pairs of bins and of components.
        pairs = C.reshape(*C.shape[:-2], n, 3, n, 3)
        pairs *= np.exp(-distance / self.drift_length)[..., :, None, :, None]
        return self.with_isotropic(C, distance, map_sd)

    def with_isotropic(self, C: Matrix, distance: Matrix, map_sd: Scalars) -> Matrix:
        """Add what all components have alike to a covariance of all (..., 3 n, 3 n), in place."""
        n = distance.shape[-1]
        pairs = C.reshape(*C.shape[:-2], n, 3, n, 3)
        np.einsum("...nama->...nma", pairs)[...] += self.isotropic(distance, map_sd)[..., None]
        return C


@lru_cache(maxsize=64)
def _log_factors(spread: float) -> tuple[Scalars, Scalars]:
    deviates = np.linspace(-4, 4, 161)
    log_prior = -0.5 * deviates**2
    return spread * deviates, log_prior - np.logaddexp.reduce(log_prior)


@dataclass(frozen=True, eq=False, slots=True)
class Stretch:
    """A held-out stretch as predicted from the rest of the survey, averaged in bins."""

    positions: Points
    residual: Vectors
    map_sd: Scalars
    gradient: Tensors
    field: Vectors


def learn_path_noise(field_map: FieldMap, length: float, rng: np.random.Generator) -> tuple[PathNoise, PathNoise]:
    """Most likely covariance of residuals for a walk through a map: for registrations and for localisation.

    The decisions of registrations were fitted with a rough misfit, and with stretches that the map knows well even
    by its inflated spread. In localisation the misfit is as smooth as the stretches say, and stretches are trusted
    by the posterior itself: its inflation, which makes up for errors that no spread predicts, is no distance. What
    its positions drift is guessed as large as it was learned elsewhere, so that a pose is not stated too well.
    """
    h = field_map.hyperparameters
    guess = PathNoise.guess(length, h.noise_sd, 0.5 * h.noise_sd, 0.5 * h.noise_sd, field_map.survey.pose_sd)
    stretches, by_posterior = predict_stretches(field_map, length, rng)
    tell(f"learning the residuals along a path from {len(by_posterior)} left-out stretches")
    live_guess = replace(guess, drift_sd=max(guess.drift_sd, DRIFT * length))
    return (
        most_likely(guess, stretches) if stretches else guess,
        likelier_of_kinds(live_guess, by_posterior) if by_posterior else live_guess,
    )


def predict_stretches(
    field_map: FieldMap, length: float, rng: np.random.Generator
) -> tuple[list[Stretch], list[Stretch]]:
    """Hold out some stretches of the survey's path at a time and predict them from the rest.

    Of the bins that the rest knows: by its inflated standard deviation, and by that of the posterior itself.
    """
    samples = field_map.survey.transformed(field_map.T_map_model.inv())
    number = (path_walked(samples.positions) / (STRETCH_LENGTH * length)).astype(np.int64)
    found: tuple[list[Stretch], list[Stretch]] = ([], [])
    for is_left_out in folds_of(number):
        for kept, more in zip(found, _predict(field_map, samples, is_left_out, number, length, rng), strict=True):
            kept.extend(more)
    by_spread, by_posterior = ([kept[k] for k in even_choice(len(kept), FEW_POINTS)] for kept in found)
    return by_spread, by_posterior


def _predict(
    field_map: FieldMap, samples: Survey, is_left_out: Mask, number: Indices, length: float, rng: np.random.Generator
) -> tuple[list[Stretch], list[Stretch]]:
    """Held-out stretches as predicted from the rest of the survey, as `predict_stretches` has them."""
    h = field_map.hyperparameters
    rest = fit_posterior(samples.subset(~is_left_out), h, field_map.config, field_map.T_domain_model)
    x, b, number = samples.positions[is_left_out], samples.field[is_left_out], number[is_left_out]
    values = rest.evaluate(x, order=1)
    draws = [rest.evaluate(x, 0, w).field for w in rest.draw_weights(N_DRAWS, rng)]
    sd = np.sqrt(np.mean([((d - values.field) ** 2).mean(axis=1) for d in draws], axis=0))
    assert values.gradient is not None
    columns = (x, b - values.field, sd, values.gradient, b)
    # Bins that the rest hardly knows say little about residuals where a map does know the field.
    known, least = rest.knows(x), 0.5 * h.signal_sd
    by_spread, by_posterior = (
        _stretches(columns, number, known & (each < least), SAMPLING * length) for each in (sd, sd / h.inflation)
    )
    return by_spread, by_posterior


def _stretches(columns: tuple[np.ndarray, ...], number: Indices, is_known: Mask, side: float) -> list[Stretch]:
    """Those of samples' columns with enough bins of a side (m) that are known."""
    found = []
    for k in np.unique(number):
        rows = np.flatnonzero((number == k) & is_known)
        if len(rows) < MIN_BINS:
            continue
        bins = bin_along_path(np.ascontiguousarray(columns[0][rows]), side)
        if bins[-1] + 1 >= MIN_BINS:
            found.append(Stretch(*(bin_means(column[rows], bins) for column in columns)))
    return found


def most_likely(guess: PathNoise, stretches: list[Stretch], known: Collection[str] = ()) -> PathNoise:
    """Maximum-likelihood parameters for the stretches' residuals, under a weak prior about a guess.

    ``known``: names of those that the guess knows.
    """
    return _maximise(guess, stretches, known)[0]


def likelier_of_kinds(guess: PathNoise, stretches: list[Stretch]) -> PathNoise:
    """Choose a misfit that is rough or smooth: whichever makes the residuals likelier."""
    found = [_maximise(replace(guess, is_smooth=is_smooth), stretches) for is_smooth in (False, True)]
    return min(found, key=lambda one: one[1])[0]


def _maximise(guess: PathNoise, stretches: list[Stretch], known: Collection[str] = ()) -> tuple[PathNoise, float]:
    """The most likely parameters, and minus their log posterior but for a constant."""
    # Imported here, since the import takes longer than registering a room, and only an index needs it.
    from scipy.optimize import minimize

    names = [f.name for f in fields(guess) if f.name not in ("spread", "n_stretches", "is_smooth", *known)]
    center = np.log([getattr(guess, name) for name in names])
    stacks = _stack_alike(stretches)

    def noise_at(offset: np.ndarray) -> PathNoise:
        values = np.exp(center + np.clip(offset, -FARTHEST, FARTHEST)).tolist()
        return replace(guess, **dict(zip(names, values, strict=True)))

    def cost(offset: np.ndarray) -> tuple[float, Scalars]:
        noise = noise_at(offset)
        total, slope = 0.5 * ((offset / LOG_SD) ** 2).sum(), offset / LOG_SD**2
        for stack in stacks:
            chi2, half_log_det, by_parameter = _likelihood(noise, *stack)
            total += (0.5 * chi2 + half_log_det).sum()
            slope = slope + (np.abs(offset) < FARTHEST) * [by_parameter[name] for name in names]
        return float(total), slope

    found = minimize(cost, np.zeros(len(center)), method="L-BFGS-B", jac=True)
    noise = noise_at(found.x)
    # chi^2 itself scatters by sqrt(2 / n); what is left is how stretches differ.
    chi2 = np.concatenate([_likelihood(noise, *stack)[0] for stack in stacks])
    n_values = np.concatenate([np.full(len(stack[0]), 3 * stack[0].shape[1]) for stack in stacks])
    excess = max(float(np.mean(np.log(chi2 / n_values) ** 2 - 2 / n_values)), 0.0)
    # The guess counts as much as a few stretches.
    spread2 = (PRIOR_STRETCHES * guess.spread**2 + len(chi2) * excess) / (PRIOR_STRETCHES + len(chi2))
    return replace(noise, spread=float(np.sqrt(spread2)), n_stretches=len(chi2)), float(found.fun)


def _likelihood(
    noise: PathNoise, distance: Matrix, map_sd: Scalars, gradient: Tensors, field: Vectors, residual: Vectors
) -> tuple[Scalars, Scalars, dict[str, float]]:
    """Give chi^2 and half log-determinants of stacked stretches, (s,), and the slope of minus their log-likelihood.

    The slope by the logarithm of each parameter is half the trace of ``(C^-1 - C^-1 r r^T C^-1) dC``: one inverse
    serves all of them.
    """
    s, n = map_sd.shape
    C = noise.full(distance, map_sd, gradient, field)
    half_log_det = np.log(np.diagonal(np.linalg.cholesky(C), axis1=1, axis2=2)).sum(axis=1)
    inverse, r = np.linalg.inv(C), residual.reshape(s, -1, 1)
    whitened = inverse @ r
    W = inverse - whitened * np.swapaxes(whitened, 1, 2)

    pairs = W.reshape(s, n, 3, n, 3)
    alone, turns = np.einsum("snama->snm", pairs), skew(field.reshape(-1, 3))
    # W on what turns and shifts of the walker's frame do to the field, summed over components.
    by_turns, by_shifts = (
        np.einsum("snamb,snamb->snm", pairs, (flat @ np.swapaxes(flat, 1, 2)).reshape(pairs.shape))
        for flat in (turns.reshape(s, 3 * n, 3), gradient.reshape(s, 3 * n, 3))
    )
    fades = np.exp(-distance / noise.drift_length)
    turned, shifted = noise.attitude_sd**2 * fades * by_turns, noise.drift_sd**2 * fades * by_shifts
    x = (np.sqrt(3) if noise.is_smooth else 1.0) * distance / noise.misfit_length
    y = distance / noise.map_length
    misfit = noise.misfit_sd**2 * np.exp(-x) * alone
    of_map = noise.map_factor**2 * map_sd[:, :, None] * map_sd[:, None, :] * np.exp(-0.5 * y**2) * alone
    return (
        (r * whitened).sum(axis=(1, 2)),
        half_log_det,
        {
            "misfit_sd": float((misfit * (1 + x if noise.is_smooth else 1.0)).sum()),
            "misfit_length": 0.5 * float((misfit * (x**2 if noise.is_smooth else x)).sum()),
            "nugget_sd": noise.nugget_sd**2 * float(np.trace(alone, axis1=1, axis2=2).sum()),
            "constant_sd": noise.constant_sd**2 * float(alone.sum()),
            "map_factor": float(of_map.sum()),
            "map_length": 0.5 * float((of_map * y**2).sum()),
            "attitude_sd": float(turned.sum()),
            "drift_sd": float(shifted.sum()),
            "drift_length": 0.5 * float(((turned + shifted) * distance).sum()) / noise.drift_length,
        },
    )


def _stack_alike(stretches: list[Stretch]) -> list[tuple[np.ndarray, ...]]:
    """Stretches with the same number of bins, stacked: distance, map sd, gradient, field, residual."""
    found = []
    for n in sorted({len(s.positions) for s in stretches}):
        alike = [s for s in stretches if len(s.positions) == n]
        parts = [(cdist(s.positions, s.positions), s.map_sd, s.gradient, s.field, s.residual) for s in alike]
        found.append(tuple(np.stack(column) for column in zip(*parts, strict=True)))
    return found
