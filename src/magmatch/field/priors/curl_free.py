# SPDX-License-Identifier: BSD-3-Clause
"""Minus the gradient of a Gaussian-process potential (Solin et al. 2018), plus a constant field."""

from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import GRADIENT, CurlFreeKernel

# One weight each: as many weights as the divergence-free prior has.
MAX_INDUCING_POINTS = 3600


class CurlFreePrior(InducingPrior):
    """Curl-free exactly; one weight an inducing point."""

    def __init__(self) -> None:
        super().__init__("curl_free", CurlFreeKernel, GRADIENT, MAX_INDUCING_POINTS)
