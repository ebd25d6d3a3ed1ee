# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters of a prior."""

from dataclasses import asdict, astuple, dataclass, replace
from typing import Self

import numpy as np

# Names in reports, where they are not those of the attributes.
TOLD_NAMES = {"divergence_weight": "stiffness", "prior_scale": "looseness"}
# Spacings; each one more costs a layer of cells around all samples.
MAX_REACH = 32.0


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Numbers that shape a prior."""

    # m: distance over which the field changes; also the size of what counts as one independent cell. Of equivalent
    # sources: their distance from the samples.
    lengthscale: float
    signal_sd: float  # T: prior standard deviation of one field component (the constant field aside)
    # T: standard deviation of one measured component: sensor noise and what the model cannot represent
    noise_sd: float
    spacing: float  # m: distance of the basis nodes (inducing points, spline knots)
    # Weight of the penalty on ``div B``, relative to the prior's other terms; 0 where the prior has none
    divergence_weight: float = 0.0
    # Prior standard deviation of the basis relative to ``signal_sd``, if held-out data chose it
    prior_scale: float = 1.0
    inflation: float = 1.0  # factor on posterior standard deviations, calibrated on held-out data
    # How far the basis reaches beyond cells that hold samples, in spacings; beyond, the map knows nothing. Less
    # leaves gaps without a prediction; more costs time and pulls the rim towards zero.
    reach: float = 2.0

    def check(self) -> None:
        """Raise ValueError where no field has such numbers: those of a file are anyone's."""
        if not all(isinstance(value, int | float) for value in astuple(self)):
            msg = f"expected plain numbers, got {self}"
            raise ValueError(msg)
        positive = (self.lengthscale, self.signal_sd, self.noise_sd, self.spacing, self.prior_scale, self.inflation)
        if not all(0 < value < np.inf for value in positive):
            msg = f"expected positive lengthscale, signal_sd, noise_sd and spacing, got {self}"
            raise ValueError(msg)
        if not (0 <= self.divergence_weight < np.inf and 0 <= self.reach <= MAX_REACH):
            msg = f"expected a divergence weight that is not negative and a reach of at most {MAX_REACH}, got {self}"
            raise ValueError(msg)

    def with_noise(self, noise_sd: float) -> Self:
        """Give the same map of the same samples another statement of their noise."""
        return replace(self, noise_sd=noise_sd, prior_scale=self.prior_scale * noise_sd / self.noise_sd)

    def as_dict(self) -> dict[str, float]:
        """Plain numbers by their names in reports."""
        return {TOLD_NAMES.get(name, name): float(value) for name, value in asdict(self).items()}
