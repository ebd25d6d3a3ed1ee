# SPDX-License-Identifier: BSD-3-Clause
"""Families of field models, one file each; this table is what configuration names refer to."""

from magmatch.field.domain import Box
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.linear_model import Prior
from magmatch.field.priors.gaussian import CurlFreePrior, DivergenceFreePrior
from magmatch.field.priors.harmonic import HarmonicPrior
from magmatch.field.priors.spline import SplinePrior

# Their cost grows with the cube of their weights: not every survey can afford them.
DENSE_PRIORS: dict[str, InducingPrior | HarmonicPrior] = {
    "divergence_free": DivergenceFreePrior(),
    "curl_free": CurlFreePrior(),
    "harmonic": HarmonicPrior(),
}
PRIORS: dict[str, Prior] = {"spline": SplinePrior(), **DENSE_PRIORS}


def prior_over(name: str, box: Box | None) -> Prior:
    """Prior of a name; one that rules sources out rules them out of a declared box, too."""
    return HarmonicPrior(box=box) if name == HarmonicPrior.name and box is not None else PRIORS[name]
