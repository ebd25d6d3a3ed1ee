# SPDX-License-Identifier: BSD-3-Clause
"""Samples that contradict the others at the same place: a phone that rang, a lift that passed.

A large residual alone may be structure too fine for the map, which the samples around then share. Only a sample that
contradicts its neighbours is an outlier.
"""

import logging

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey
from magmatch.field.folds import has_path_order
from magmatch.field.linear_model import FieldPosterior
from magmatch.field.values import gradient_norm, gradient_of
from magmatch.geometry import typical_step
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# Residuals this many times the typical one are examined.
THRESHOLD = 6.0
# In the same measure, a robust fit begins to doubt a sample here; its doubts settle in so many rounds.
SOFT, ROUNDS = 3.0, 4
# Doubtful samples count less only within a lengthscale of a large residual; how many are weighed together.
MOST_TOGETHER = 400
# The map's own noise may be larger than its residuals say, where it follows them closely; this much of it they are.
LEAST_SHARE_OF_NOISE = 0.5
# Residuals small relative to the field itself are harmless, however exact the rest.
LEAST_SHARE_OF_SIGNAL = 0.01
# The median length of a standard normal 3-vector.
MEDIAN_LENGTH = 1.538
# Neighbours asked, within a spacing, and how many have to agree.
N_NEIGHBOURS, FEWEST_WITNESSES = 64, 3
# Samples along a path count as one pass within so many times that distance.
SAME_PASS = 5.0
# A neighbour agrees that shows this share of the residual; of them, so many may, since they may be outliers too.
LARGEST_AGREEMENT, MOST_AGREEING = 0.25, 0.1
# What the field changes by within this share of the spacing denies nothing: steep fields have structure finer than
# the splines, that one sample sees and none around. False alarms in simulated rooms need up to 0.18, what recordings
# of two buildings contradict 0.23 and more.
LEAST_SHIFT = 0.2
# Among fewer samples nobody can tell which are ordinary.
FEWEST_SAMPLES = 100
# A map of which more is in doubt does not fit its survey: then nothing is left out.
LARGEST_SHARE = 0.05
# Share of the squared residuals below which samples did not shape the fit.
LITTLE_POWER = 0.2
# Nor does a map of which so much stands out at first, before those that pulled it to them count less.
LARGEST_SHARE_AT_FIRST = 0.3


def find_outliers(samples: Survey, posterior: FieldPosterior) -> Mask:
    """Samples whose residual is large and unlike those of their neighbours."""
    points, field = samples.positions, samples.field
    is_out = np.zeros(len(samples), dtype=bool)
    if len(samples) < FEWEST_SAMPLES:
        return is_out
    residual = field - posterior.evaluate(points).field
    noise = _noise(residual, posterior)
    is_large = _sizes(residual) > THRESHOLD * noise
    if not is_large.any():
        return is_out
    if is_large.mean() <= LARGEST_SHARE_AT_FIRST:
        for rows in _doubtful(points, residual, is_large, noise, posterior):
            residual[rows] = robust_residuals(posterior, points[rows], residual[rows], noise)
        is_large = _sizes(residual) > THRESHOLD * noise
        is_out[is_large] = _are_denied(points, residual, is_large, posterior.hyperparameters.spacing)
        is_out[is_out] = ~_may_be_fine_structure(points[is_out], residual[is_out], posterior)
    if is_out.mean() > LARGEST_SHARE or is_large.mean() > 2 * LARGEST_SHARE:
        log.warning(
            "%d of %d samples contradict their neighbours: too many to leave out; look for poses that jump or metal "
            "that moves", max(is_out.sum(), is_large.sum()), len(is_out),
        )  # fmt: skip
        return np.zeros_like(is_out)
    return is_out


def hardly_moved(samples: Survey, posterior: FieldPosterior, rows: Mask) -> bool:
    """Whether some samples have so small a share of the squared residuals that they hardly affected the fit."""
    power = ((samples.field - posterior.evaluate(samples.positions).field) ** 2).sum(axis=1)
    return bool(power[rows].sum() / max(power.sum(), np.finfo(float).tiny) < LITTLE_POWER)


def robust_residuals(posterior: FieldPosterior, points: Points, residual: Vectors, noise: float) -> Vectors:
    """Residuals of samples without the influence of those that stand out, without fitting again."""
    influence, left = posterior.influence(points), residual
    for _ in range(ROUNDS):
        # Geman-McClure: outliers hardly count, so that their influence on the fit cannot mask them.
        weights = 1 / (1 + (_sizes(left) / (SOFT * noise)) ** 2) ** 2
        left = reweighted_residuals(influence, residual, weights)
    return left


def reweighted_residuals(influence: Matrix, residual: Vectors, weights: Scalars) -> Vectors:
    """Residuals of a fit with reduced weights of some samples, from its residuals with equal weights.

    With A the posterior precision in units of the noise, Phi the samples' rows and D = 1 - weights, the basis' new
    weights w' obey ``A (w' - w) = -Phi^T D (b - Phi w')``; with ``C = Phi A^-1 Phi^T`` hence ``r' = r + C D r'``.
    """
    D = np.repeat(1 - weights, 3)
    left: Vectors = np.linalg.solve(np.eye(len(D)) - influence * D, residual.ravel()).reshape(-1, 3)
    return left


def _doubtful(
    points: Points, residual: Vectors, is_large: Mask, noise: float, posterior: FieldPosterior
) -> list[Indices]:
    """Samples in doubt around large residuals, in groups that bear on one another and are small enough."""
    doubtful = np.flatnonzero(_sizes(residual) > SOFT * noise)
    distance = cKDTree(points[is_large]).query(points[doubtful])[0]
    return _halved(points, doubtful[distance <= posterior.hyperparameters.lengthscale])


def _halved(points: Points, rows: Indices) -> list[Indices]:
    """Rows in groups of neighbours, each of at most `MOST_TOGETHER`."""
    if len(rows) <= MOST_TOGETHER:
        return [rows]
    along = points[rows, np.argmax(np.ptp(points[rows], axis=0))]
    order = np.argsort(along, kind="stable")
    return [part for half in np.array_split(rows[order], 2) for part in _halved(points, half)]


def _sizes(residual: Vectors) -> Scalars:
    return np.asarray(np.linalg.norm(residual, axis=1))


def _noise(residual: Vectors, posterior: FieldPosterior) -> float:
    """Spread of ordinary residuals of one component, T."""
    typical = float(np.median(_sizes(residual))) / MEDIAN_LENGTH
    h = posterior.hyperparameters
    return max(typical, LEAST_SHARE_OF_NOISE * h.noise_sd, LEAST_SHARE_OF_SIGNAL * h.signal_sd)


def _may_be_fine_structure(points: Points, residual: Vectors, posterior: FieldPosterior) -> Mask:
    """Whether the field changes by as much as these residuals within a small part of the spacing."""
    steepness = gradient_norm(gradient_of(posterior.evaluate(points, order=1)))
    return np.asarray(_sizes(residual) < LEAST_SHIFT * posterior.hyperparameters.spacing * steepness)


def _are_denied(points: Points, residual: Vectors, is_large: Mask, reach: float) -> Mask:
    """Whether enough samples of other passes lie around each large residual, and none shows a part of it."""
    large = np.flatnonzero(is_large)
    k = min(N_NEIGHBOURS + 1, len(points))
    distance, number = cKDTree(points).query(points[large], k=k, distance_upper_bound=reach)
    is_witness = np.isfinite(distance) & (number != large[:, None])
    if has_path_order(points):
        # A passing lift affects many consecutive samples: they must not confirm each other.
        step = typical_step(np.linalg.norm(np.diff(points, axis=0), axis=1))
        same_pass = SAME_PASS * reach / max(step, 1e-300)
        is_witness &= np.abs(number - large[:, None]) > same_pass
    around = residual[np.where(is_witness, number, 0)]
    size = np.linalg.norm(residual[large], axis=1, keepdims=True)
    # Of structure that the map is too coarse for, what lies around shows a part.
    share = np.einsum("nkc,nc->nk", around, residual[large] / size) / size
    n_witnesses = is_witness.sum(axis=1)
    n_agreeing = (is_witness & (share > LARGEST_AGREEMENT)).sum(axis=1)
    return np.asarray((n_witnesses >= FEWEST_WITNESSES) & (n_agreeing <= MOST_AGREEING * n_witnesses))
