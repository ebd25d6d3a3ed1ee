# SPDX-License-Identifier: BSD-3-Clause
"""The prior of the splines in units of the noise, and its value where there are no splines."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.element_matrices import lone_cell_covariance, prior_element
from magmatch.field.spline.spline_basis import GRADIENT_INDEX

# Prior standard deviation of the constant field, T: broad against the Earth's (25 to 65 uT) and a sensor's offset. A
# zero-mean field of that size would otherwise dictate lengthscale and signal.
CONSTANT_SD = 1e-4
# Finer spacings than this share of the lengthscale change nothing but rounding errors.
HIGHEST_RELATIVE_LENGTHSCALE = 12.0


def prior_terms(h: Hyperparameters) -> tuple[np.ndarray, np.ndarray]:
    """Element matrix of the prior and what it says about a lone sample's cell (both up to scale)."""
    relative = min(h.lengthscale / h.spacing, HIGHEST_RELATIVE_LENGTHSCALE)
    return prior_element(relative, h.divergence_weight), lone_cell_covariance(relative, h.divergence_weight, h.reach)


def relative_prior_precision(h: Hyperparameters) -> float:
    """Factor from the prior's shape to the prior, in units of the noise."""
    return (h.noise_sd / (h.prior_scale * h.signal_sd)) ** 2


def constant_precision(h: Hyperparameters) -> float:
    """Prior precision of the constant field in units of the noise's."""
    return (h.noise_sd / CONSTANT_SD) ** 2


def cell_precision(h: Hyperparameters) -> np.ndarray:
    """Prior precision of one cell of weight 1 in units of the noise's: (64, 64)."""
    element, covariance = prior_terms(h)
    return np.asarray(element * (relative_prior_precision(h) * covariance[0, 0]))


def prior_outside(h: Hyperparameters) -> np.ndarray:
    """Prior covariance of field and distinct gradient entries where there are no splines: (9, 9)."""
    prior = prior_terms(h)[1] / prior_terms(h)[1][0, 0]
    per_spacing = np.repeat([1.0, 1.0 / h.spacing], [3, 6])
    return np.asarray(h.signal_sd**2 * prior * np.outer(per_spacing, per_spacing))


def outside_covariance(h: Hyperparameters, constant: np.ndarray) -> np.ndarray:
    """Covariance of field and gradient (row-major) where there is only a constant, of given covariance: (12, 12)."""
    covariance = expand(prior_outside(h)[None])[0]
    covariance[:3, :3] += constant
    return np.asarray(covariance)


def expand(covariance: np.ndarray) -> np.ndarray:
    """From field and 6 distinct gradient entries to field and all 9, row-major."""
    rows = np.concatenate([np.arange(3), 3 + GRADIENT_INDEX.ravel()])
    return np.asarray(covariance[:, rows[:, None], rows])
