# SPDX-License-Identifier: BSD-3-Clause
"""Samples that contradict the others at the same place: a phone that rang, a lift that passed.

A large residual alone may be structure that the map is too coarse for; then the samples around share it. Only what
its neighbours deny is an outlier.
"""

import logging
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.survey import Survey
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
N_NEIGHBOURS, FARTHEST, FEWEST_WITNESSES = 16, 1.0, 3
# Share of the residual that any of them may have in its direction.
LARGEST_AGREEMENT = 0.25
# A map of which more is in doubt does not fit its survey: then nothing is left out.
LARGEST_SHARE = 0.05


def find_outliers(samples: Survey, posterior: Posterior, model: LinearModel[Any]) -> Mask:
    """Samples whose residual is large and unlike those of the samples around.

    Parameters
    ----------
    samples : Survey
        In the model's frame.
    posterior : Posterior
        Fitted to all of them alike.
    model : LinearModel
        To fit again, with those that stand out weighed down so that they do not pull the map to them.

    Returns
    -------
    (n,) bool array
        None where more than 5 % would be out.
    """
    points, field = samples.positions, samples.field
    residual = field - posterior.evaluate(points).field
    noise = _noise(residual, posterior)
    for _ in range(ROUNDS):
        if not (np.linalg.norm(residual, axis=1) > THRESHOLD * noise).any():
            return np.zeros(len(samples), dtype=bool)
        # Geman-McClure: what lies far outside hardly counts, so that it cannot hide behind what it did to the fit.
        weights = 1 / (1 + (residual**2).sum(axis=1) / (SOFT * noise) ** 2) ** 2
        residual = field - model.infer(model.observe(points, field, weights)).evaluate(points).field
        noise = _noise(residual, posterior)
    is_large = np.linalg.norm(residual, axis=1) > THRESHOLD * noise
    is_out = np.zeros(len(samples), dtype=bool)
    if is_large.any():
        reach = FARTHEST * posterior.hyperparameters.spacing
        is_out[is_large] = _are_denied(points, residual, is_large, reach)
    if is_out.mean() > LARGEST_SHARE:
        log.warning(
            "%d of %d samples contradict those around them: too many to leave out; look for poses that jump or metal "
            "that moves", is_out.sum(), len(is_out),
        )  # fmt: skip
        return np.zeros_like(is_out)
    return is_out


def _noise(residual: Vectors, posterior: Posterior) -> float:
    """Spread of ordinary residuals of one component, T."""
    typical = float(np.median(np.linalg.norm(residual, axis=1))) / MEDIAN_LENGTH
    h = posterior.hyperparameters
    return max(typical, LEAST_SHARE_OF_NOISE * h.noise_sd, LEAST_SHARE_OF_SIGNAL * h.signal_sd)


def _are_denied(points: Points, residual: Vectors, is_large: Mask, reach: float) -> Mask:
    """Whether enough samples of ordinary residuals lie around each large one, and differ from it."""
    ordinary = ~is_large
    if ordinary.sum() < N_NEIGHBOURS:
        return np.zeros(int(is_large.sum()), dtype=bool)
    distance, number = cKDTree(points[ordinary]).query(points[is_large], k=N_NEIGHBOURS, distance_upper_bound=reach)
    is_witness = np.isfinite(distance)
    around = residual[ordinary][np.where(is_witness, number, 0)]
    size = np.linalg.norm(residual[is_large], axis=1, keepdims=True)
    # Of structure that the map is too coarse for, what lies around shows a part.
    share = np.einsum("nkc,nc->nk", around, residual[is_large] / size) / size
    agrees = (is_witness & (share > LARGEST_AGREEMENT)).any(axis=1)
    return np.asarray((is_witness.sum(axis=1) >= FEWEST_WITNESSES) & ~agrees)
