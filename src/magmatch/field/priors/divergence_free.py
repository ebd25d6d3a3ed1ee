# SPDX-License-Identifier: BSD-3-Clause
"""The published prior: a divergence-free Gaussian process over inducing points on a grid, plus a constant field."""

from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, DivergenceFreeKernel
from magmatch.field.spline.spline_prior import CONSTANT_SD

# Three weights each: more take minutes.
MAX_INDUCING_POINTS = 1200


class DivergenceFreePrior(InducingPrior):
    """Divergence-free exactly; three weights an inducing point."""

    def __init__(self, most: int = MAX_INDUCING_POINTS, constant_sd: float = CONSTANT_SD) -> None:
        super().__init__("divergence_free", DivergenceFreeKernel, DIVERGENCE_FREE, most, constant_sd)
