# SPDX-License-Identifier: BSD-3-Clause
"""How a map is made from samples."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class FieldConfig(BaseModel):
    """Settings of the field inference; what is None is chosen from the data."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Which law and basis: 'spline' (soft div B = 0, sparse) or 'divergence_free' (published).
    prior: Literal["spline", "divergence_free"] = "spline"
    # Distance over which the field changes, m. None: chosen from the data.
    lengthscale: float | None = Field(default=None, gt=0)
    # Prior standard deviation of one field component, T. None: chosen from the data.
    signal_sd: float | None = Field(default=None, gt=0)
    # Standard deviation of one measured component, T. None: chosen from the data.
    noise_sd: float | None = Field(default=None, gt=0)
    # Distance of the basis nodes, m. None: from the lengthscale and the size of the region.
    spacing: float | None = Field(default=None, gt=0)
    # Box to map, map frame, (x0, y0, z0, x1, y1, z1), m. None: the samples' box plus one lengthscale.
    domain: tuple[float, float, float, float, float, float] | None = None
