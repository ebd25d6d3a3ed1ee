# SPDX-License-Identifier: BSD-3-Clause
"""Families of field models, one file each; this table is what configuration names refer to."""

from magmatch.field.linear_model import Prior
from magmatch.field.priors.curl_free import CurlFreePrior
from magmatch.field.priors.divergence_free import DivergenceFreePrior
from magmatch.field.priors.harmonic import HarmonicPrior
from magmatch.field.priors.spline import SplinePrior

PRIORS: dict[str, Prior] = {
    "spline": SplinePrior(),
    "divergence_free": DivergenceFreePrior(),
    "curl_free": CurlFreePrior(),
    "harmonic": HarmonicPrior(),
}
