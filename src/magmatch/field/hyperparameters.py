# SPDX-License-Identifier: BSD-3-Clause
"""The few numbers a prior needs, and how they are stated."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

# Spacings; each one more costs a layer of cells around all samples.
MAX_REACH = 32.0


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Numbers that shape a prior.

    Attributes
    ----------
    lengthscale : float, m
        Distance over which the field changes; also the size of what counts as one independent cell. Of equivalent
        sources: their distance from the samples.
    signal_sd : float, T
        Prior standard deviation of one field component (the constant field aside).
    noise_sd : float, T
        Standard deviation of one measured component: sensor noise and what the model cannot follow.
    spacing : float, m
        Distance of the basis nodes (inducing points, spline knots).
    stiffness : float
        Weight of the soft law ``div B = 0`` relative to the prior's own scale; 0 where the prior has none.
    looseness : float
        Prior standard deviation of the basis relative to ``signal_sd``, where held-out data chose it.
    inflation : float
        Factor on posterior standard deviations that held-out data ask for.
    reach : float
        How far the basis reaches beyond cells that hold samples, in spacings; beyond, the map knows nothing. Less
        leaves gaps without a prediction; more costs time and pulls the rim towards zero.
    """

    lengthscale: float
    signal_sd: float
    noise_sd: float
    spacing: float
    stiffness: float = 0.0
    looseness: float = 1.0
    inflation: float = 1.0
    reach: float = 2.0

    def check(self) -> None:
        """Raise ValueError where no field has such numbers: those of a file are anyone's."""
        positive = (self.lengthscale, self.signal_sd, self.noise_sd, self.spacing, self.looseness, self.inflation)
        if not all(0 < value < np.inf for value in positive):
            msg = f"expected positive lengthscale, signal_sd, noise_sd and spacing, got {self}"
            raise ValueError(msg)
        if not (0 <= self.stiffness < np.inf and 0 <= self.reach <= MAX_REACH):
            msg = f"expected a stiffness that is not negative and a reach of at most {MAX_REACH}, got {self}"
            raise ValueError(msg)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for saving."""
        return asdict(self)
