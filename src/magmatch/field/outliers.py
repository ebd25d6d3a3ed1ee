# SPDX-License-Identifier: BSD-3-Clause
"""Samples that contradict the others at the same place: a phone that rang, a lift that passed.

A large residual alone may be structure that the map is too coarse for; then the samples around share it. Only what
its neighbours deny is an outlier.
"""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey
from magmatch.field.held_out import has_path_order
from magmatch.field.linear_model import LinearModel, Posterior
from magmatch.typing import Mask, Points, Vectors

log = logging.getLogger(__name__)

# Residuals this many times the typical one are looked at.
THRESHOLD = 6.0
# What counts half in a robust fit, in the same measure, and how often it is fitted.
SOFT, ROUNDS = 3.0, 4
# The map's own noise may be larger than its residuals say, where it follows them closely; this much of it they are.
LEAST_SHARE_OF_NOISE = 0.5
# What is small beside the field itself does no harm, however exact the rest.
LEAST_SHARE_OF_SIGNAL = 0.01
# The median length of a standard normal 3-vector.
MEDIAN_LENGTH = 1.538
# Neighbours asked, how far they may be (in spacings), and how many have to agree.
N_NEIGHBOURS, FARTHEST, FEWEST_WITNESSES = 64, 1.0, 3
# Samples along a path count as one pass within so many times that distance.
SAME_PASS = 5.0
# A neighbour agrees that shows this share of the residual; of them, so many may, since they may be outliers too.
LARGEST_AGREEMENT, MOST_AGREEING = 0.25, 0.1
# Of fewer samples nobody can tell which are ordinary.
FEWEST_SAMPLES = 100
# A map of which more is in doubt does not fit its survey: then nothing is left out.
LARGEST_SHARE = 0.05


def find_outliers(samples: Survey, posterior: Posterior, lay: Callable[[], LinearModel[Any]]) -> Mask:
    """Samples whose residual is large and unlike those of the samples around.

    Parameters
    ----------
    samples : Survey
        In the model's frame.
    posterior : Posterior
        Fitted to all of them alike.
    lay : function
        Gives the model, to fit again with those that stand out weighed down so that they do not pull the map to them;
        asked only if any do.

    Returns
    -------
    (n,) bool array
        None where more than 5 % would be out.
    """
    points, field = samples.positions, samples.field
    if len(samples) < FEWEST_SAMPLES:
        return np.zeros(len(samples), dtype=bool)
    residual = field - posterior.evaluate(points).field
    noise, model = _noise(residual, posterior), None
    is_large: Mask = np.linalg.norm(residual, axis=1) > THRESHOLD * noise
    for _ in range(ROUNDS):
        if not is_large.any():
            return is_large
        model = lay() if model is None else model
        # Geman-McClure: what lies far outside hardly counts, so that it cannot hide behind what it did to the fit.
        weights = 1 / (1 + (residual**2).sum(axis=1) / (SOFT * noise) ** 2) ** 2
        residual = field - model.infer(model.observe(points, field, weights)).evaluate(points).field
        noise, before = _noise(residual, posterior), is_large
        is_large = np.linalg.norm(residual, axis=1) > THRESHOLD * noise
        if np.array_equal(is_large, before):
            break
    is_out = np.zeros(len(samples), dtype=bool)
    if is_large.any():
        reach = FARTHEST * posterior.hyperparameters.spacing
        is_out[is_large] = _are_denied(points, residual, is_large, reach)
    if is_out.mean() > LARGEST_SHARE or is_large.mean() > 2 * LARGEST_SHARE:
        log.warning(
            "%d of %d samples contradict those around them: too many to leave out; look for poses that jump or metal "
            "that moves", max(is_out.sum(), is_large.sum()), len(is_out),
        )  # fmt: skip
        return np.zeros_like(is_out)
    return is_out


def _noise(residual: Vectors, posterior: Posterior) -> float:
    """Spread of ordinary residuals of one component, T."""
    typical = float(np.median(np.linalg.norm(residual, axis=1))) / MEDIAN_LENGTH
    h = posterior.hyperparameters
    return max(typical, LEAST_SHARE_OF_NOISE * h.noise_sd, LEAST_SHARE_OF_SIGNAL * h.signal_sd)


def _are_denied(points: Points, residual: Vectors, is_large: Mask, reach: float) -> Mask:
    """Whether enough samples of other passes lie around each large residual, and none shows a part of it."""
    large = np.flatnonzero(is_large)
    k = min(N_NEIGHBOURS + 1, len(points))
    distance, number = cKDTree(points).query(points[large], k=k, distance_upper_bound=reach)
    is_witness = np.isfinite(distance) & (number != large[:, None])
    if has_path_order(points):
        # A lift that passes is seen by many samples in a row: they may not bear each other out.
        step = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        same_pass = SAME_PASS * reach / max(step, 1e-300)
        is_witness &= np.abs(number - large[:, None]) > same_pass
    around = residual[np.where(is_witness, number, 0)]
    size = np.linalg.norm(residual[large], axis=1, keepdims=True)
    # Of structure that the map is too coarse for, what lies around shows a part.
    share = np.einsum("nkc,nc->nk", around, residual[large] / size) / size
    n_witnesses = is_witness.sum(axis=1)
    n_agreeing = (is_witness & (share > LARGEST_AGREEMENT)).sum(axis=1)
    return np.asarray((n_witnesses >= FEWEST_WITNESSES) & (n_agreeing <= MOST_AGREEING * n_witnesses))
