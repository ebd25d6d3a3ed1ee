# SPDX-License-Identifier: BSD-3-Clause
"""The published prior: a divergence-free Gaussian process over inducing points on a grid, plus a constant field."""

from magmatch.field.inducing.inducing_prior import InducingConfig, InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, DivergenceFreeKernel


class DivergenceFreePrior(InducingPrior):
    """Divergence-free exactly; three weights an inducing point."""

    def __init__(self, config: InducingConfig | None = None) -> None:
        super().__init__("divergence_free", DivergenceFreeKernel, DIVERGENCE_FREE, config or InducingConfig())
