# SPDX-License-Identifier: BSD-3-Clause
"""Minus the gradient of a Gaussian-process potential (Solin et al. 2018), plus a constant field."""

from pydantic import Field

from magmatch.field.inducing.inducing_prior import InducingConfig, InducingPrior
from magmatch.field.inducing.kernels import GRADIENT, CurlFreeKernel


class CurlFreeConfig(InducingConfig):
    """Settings of the potential."""

    # One weight each: as many weights as the divergence-free prior has.
    max_inducing_points: int = Field(default=3600, ge=8)


class CurlFreePrior(InducingPrior):
    """Curl-free exactly; one weight an inducing point."""

    def __init__(self, config: CurlFreeConfig | None = None) -> None:
        super().__init__("curl_free", CurlFreeKernel, GRADIENT, config or CurlFreeConfig())
