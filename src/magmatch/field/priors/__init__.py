# SPDX-License-Identifier: BSD-3-Clause
"""Families of field models, one file each; this table is what configuration names refer to."""

from magmatch.field.domain import Box
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, GRADIENT, CurlFreeKernel, DivergenceFreeKernel
from magmatch.field.linear_model import Prior
from magmatch.field.priors.harmonic import HarmonicPrior
from magmatch.field.priors.spline import SplinePrior

# Three weights each: more take minutes.
MAX_INDUCING_POINTS = 1200
# Their cost grows with the cube of their weights: not every survey can afford them. The first is published; the
# second, minus the gradient of a potential (Solin et al. 2018), has one weight an inducing point.
DENSE_PRIORS: dict[str, InducingPrior | HarmonicPrior] = {
    "divergence_free": InducingPrior("divergence_free", DivergenceFreeKernel, DIVERGENCE_FREE, MAX_INDUCING_POINTS),
    "curl_free": InducingPrior("curl_free", CurlFreeKernel, GRADIENT, 3 * MAX_INDUCING_POINTS),
    "harmonic": HarmonicPrior(),
}
PRIORS: dict[str, Prior] = {"spline": SplinePrior(), **DENSE_PRIORS}


def prior_over(name: str, box: Box | None) -> Prior:
    """Prior of a name; one that rules sources out rules them out of a declared box, too."""
    return HarmonicPrior(box=box) if name == HarmonicPrior.name and box is not None else PRIORS[name]
