# SPDX-License-Identifier: BSD-3-Clause
"""The priors of Gaussian processes over inducing points on a grid, plus a constant field; the first is published."""

from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, GRADIENT, CurlFreeKernel, DivergenceFreeKernel
from magmatch.field.spline.spline_prior import CONSTANT_SD

# Three weights each: more take minutes.
MAX_INDUCING_POINTS = 1200


class DivergenceFreePrior(InducingPrior):
    """Divergence-free exactly; three weights an inducing point."""

    def __init__(self, most: int = MAX_INDUCING_POINTS, constant_sd: float = CONSTANT_SD) -> None:
        super().__init__("divergence_free", DivergenceFreeKernel, DIVERGENCE_FREE, most, constant_sd)


class CurlFreePrior(InducingPrior):
    """Minus the gradient of a potential (Solin et al. 2018): curl-free exactly; one weight an inducing point."""

    def __init__(self) -> None:
        super().__init__("curl_free", CurlFreeKernel, GRADIENT, 3 * MAX_INDUCING_POINTS)
