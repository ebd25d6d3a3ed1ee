# SPDX-License-Identifier: BSD-3-Clause
"""What another walk's residuals against a map look like, learned from the map's own left-out stretches.

Along a path the residuals of a right pose are anything but independent: the map's error, moved iron and drifting
poses last for metres. Stretches of the base survey are left out, predicted from the rest of it, and the parameters of
the residuals' covariance are the most likely ones; where the base never passes a place twice, they stay near a guess.
"""

import logging
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from magmatch.field.fit import fit_posterior
from magmatch.field.map import FieldMap
from magmatch.registration.walk import bin_along_path
from magmatch.typing import Matrix, Points, Scalars, Tensors, Vectors

log = logging.getLogger(__name__)

# Of the base's path: length of a left-out stretch in lengthscales, and every how many-th is left out.
STRETCH_LENGTHSCALES = 6.0
EVERY = 5
# Bins per stretch and its step in lengthscales.
STEP_LENGTHSCALES = 0.3
MIN_BINS = 8
MAX_STRETCHES = 40
# Spread (natural log) of the guess that the data correct.
PRIOR_LOG_SD = 0.7
PRIOR_STRETCHES = 5
N_DRAWS = 12


@dataclass(frozen=True, slots=True)
class PathNoise:
    """Covariance of the residuals along a path, beside the map's own spread.

    Attributes
    ----------
    misfit_sd, misfit_length : float, T and m
        What lasts: ``sd^2 exp(-d / length)``.
    nugget_sd : float, T
        What each bin has for itself.
    constant_sd : float, T
        What is shared by the whole walk.
    drift_sd, drift_length : float, m
        Error of the positions along the path, seen through the field's gradient: ``sd^2 exp(-d / length)``.
    spread : float
        Natural logarithm by which the whole covariance differs from walk to walk (standard deviation).
    """

    misfit_sd: float
    misfit_length: float
    nugget_sd: float
    constant_sd: float
    drift_sd: float
    drift_length: float
    spread: float = 0.5

    @property
    def total_sd(self) -> float:
        """Standard deviation of one component between two walks through one place, drift left out, T."""
        return float(np.sqrt(self.misfit_sd**2 + self.nugget_sd**2 + self.constant_sd**2))

    def most_likely_factor(self, chi2: float, n_free: int) -> tuple[float, float]:
        """Factor on the covariance that explains one walk best, given how walks differ.

        Parameters
        ----------
        chi2 : float
            Squared whitened residuals.
        n_free : int
            Their number less the fitted parameters.

        Returns
        -------
        factor : float
        log_likelihood : float, nats
            ``-chi2 / 2 k - n/2 ln k - (ln k)^2 / 2 spread^2`` at its maximum over k.
        """
        log_factor = np.linspace(-4, 4, 161) * self.spread
        found = -0.5 * chi2 * np.exp(-log_factor) - 0.5 * n_free * log_factor - 0.5 * (log_factor / self.spread) ** 2
        best = int(np.argmax(found))
        return float(np.exp(log_factor[best])), float(found[best])

    def isotropic(self, distance: Matrix, map_sd: Scalars, lengthscale: float) -> Matrix:
        """Covariance of one component: all but the drift; (..., n, n), T^2.

        Parameters
        ----------
        distance : (..., n, n) array, m
            Between the bins.
        map_sd : (..., n) array, T
            The map's own spread at the bins; its error is correlated over the lengthscale.
        lengthscale : float, m

        Returns
        -------
        (..., n, n) array
        """
        C = self.misfit_sd**2 * np.exp(-distance / self.misfit_length) + self.constant_sd**2
        C = C + map_sd[..., :, None] * map_sd[..., None, :] * np.exp(-0.5 * (distance / lengthscale) ** 2)
        C = C + self.nugget_sd**2 * np.eye(distance.shape[-1])
        return np.asarray(C)

    def full(self, distance: Matrix, map_sd: Scalars, lengthscale: float, gradient: Tensors) -> Matrix:
        """Covariance of all components, rows ordered bin by bin: (..., 3 n, 3 n), T^2."""
        n = distance.shape[-1]
        C = self.drift_sd**2 * np.einsum(
            "...iac,...jbc,...ij->...iajb", gradient, gradient, np.exp(-distance / self.drift_length), optimize=True
        )
        iso = self.isotropic(distance, map_sd, lengthscale)
        for a in range(3):
            C[..., :, a, :, a] += iso
        return np.asarray(C.reshape(*C.shape[:-4], 3 * n, 3 * n))


@dataclass(frozen=True, eq=False, slots=True)
class Stretch:
    """A left-out stretch as the rest of the survey predicts it, averaged in bins."""

    positions: Points
    residual: Vectors
    map_sd: Scalars
    gradient: Tensors


def learn_path_noise(field_map: FieldMap, rng: np.random.Generator) -> PathNoise:
    """Most likely covariance of residuals for a walk through a map.

    Parameters
    ----------
    field_map : FieldMap
    rng : numpy Generator
        Draws that give the spread of the map without the stretches.

    Returns
    -------
    PathNoise
    """
    h = field_map.hyperparameters
    guess = PathNoise(
        misfit_sd=h.noise_sd,
        misfit_length=h.lengthscale,
        nugget_sd=0.5 * h.noise_sd,
        constant_sd=0.5 * h.noise_sd,
        drift_sd=max(field_map.survey.pose_sd, 0.02 * h.lengthscale),
        drift_length=4 * h.lengthscale,
    )
    stretches = predict_stretches(field_map, rng)
    log.info("learning the residuals along a path from %d left-out stretches", len(stretches))
    if not stretches:
        return guess
    return most_likely(guess, stretches, h.lengthscale)


def predict_stretches(field_map: FieldMap, rng: np.random.Generator) -> list[Stretch]:
    """Leave out every fifth stretch of the survey's path and predict it from the rest.

    Parameters
    ----------
    field_map : FieldMap
    rng : numpy Generator

    Returns
    -------
    list of Stretch
        Those that the rest of the survey still knows.
    """
    h = field_map.hyperparameters
    samples = field_map.survey.transformed(field_map.T_map_model.inv())
    steps = np.linalg.norm(np.diff(samples.positions, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    stretch = (arc / (STRETCH_LENGTHSCALES * h.lengthscale)).astype(np.int64)
    is_left_out = stretch % EVERY == EVERY // 2
    if not is_left_out.any() or is_left_out.all():
        return []
    rest = fit_posterior(samples.subset(~is_left_out), h, field_map.config)
    x, b, stretch = samples.positions[is_left_out], samples.field[is_left_out], stretch[is_left_out]
    values = rest.evaluate(x, order=1)
    draws = [rest.evaluate(x, 0, w).field for w in rest.draw_weights(N_DRAWS, rng)]
    sd = np.sqrt(np.mean([((d - values.field) ** 2).mean(axis=1) for d in draws], axis=0))
    # What the rest hardly knows says little about residuals where a map does know the field.
    is_known = rest.knows(x) & (sd < 0.5 * h.signal_sd)
    found = []
    for k in np.unique(stretch):
        rows = np.flatnonzero((stretch == k) & is_known)
        if len(rows) < MIN_BINS:
            continue
        bins = bin_along_path(np.ascontiguousarray(x[rows]), STEP_LENGTHSCALES * h.lengthscale)
        if bins[-1] + 1 >= MIN_BINS and values.gradient is not None:
            found.append(
                Stretch(
                    *(_bin_means(v[rows], bins) for v in (x, b - values.field, sd, values.gradient)),
                )
            )
    chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), MAX_STRETCHES)).astype(np.int64))
    return [found[k] for k in chosen]


def most_likely(guess: PathNoise, stretches: list[Stretch], lengthscale: float) -> PathNoise:
    """Parameters that explain the stretches' residuals best, held loosely near a guess.

    Parameters
    ----------
    guess : PathNoise
    stretches : list of Stretch
    lengthscale : float, m
        Of the map.

    Returns
    -------
    PathNoise
    """
    center = np.log(astuple(guess)[:-1])
    distances = [cdist(s.positions, s.positions) for s in stretches]

    def whiten(noise: PathNoise) -> list[tuple[float, float, int]]:
        found = []
        for s, d in zip(stretches, distances, strict=True):
            L = np.linalg.cholesky(noise.full(d, s.map_sd, lengthscale, s.gradient))
            z = np.linalg.solve(L, s.residual.ravel())
            found.append((float(z @ z), float(np.log(np.diag(L)).sum()), len(z)))
        return found

    def cost(offset: np.ndarray) -> float:
        fits = whiten(PathNoise(*np.exp(center + offset).tolist()))
        return 0.5 * float(((offset / PRIOR_LOG_SD) ** 2).sum()) + sum(
            0.5 * chi2 + log_det for chi2, log_det, _ in fits
        )

    start = np.zeros(len(center))
    found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 250, "initial_simplex": _simplex(start)})
    noise = PathNoise(*np.exp(center + found.x).tolist())
    # chi^2 itself scatters by sqrt(2 / n); what is left is how stretches differ.
    fits = whiten(noise)
    log_factors = np.array([np.log(chi2 / n) for chi2, _, n in fits])
    scatter = float(np.mean([2 / n for _, _, n in fits]))
    excess = max(float(np.mean(log_factors**2)) - scatter, 0.0)
    # As many stretches' worth of the guess as of a handful of them.
    spread2 = (PRIOR_STRETCHES * guess.spread**2 + len(fits) * excess) / (PRIOR_STRETCHES + len(fits))
    return replace(noise, spread=float(np.sqrt(spread2)))


def _simplex(start: np.ndarray) -> Matrix:
    corners: Matrix = np.concatenate([start[None], start + 0.5 * np.eye(len(start))])
    return corners


def _bin_means(values: np.ndarray, bins: np.ndarray) -> np.ndarray:
    sums = np.zeros((int(bins[-1]) + 1, *values.shape[1:]))
    np.add.at(sums, bins, values)
    return np.asarray(sums / np.bincount(bins).reshape(-1, *[1] * (values.ndim - 1)))
