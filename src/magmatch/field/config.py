# SPDX-License-Identifier: BSD-3-Clause
"""How a map is made from samples."""

from typing import Literal, Self

from pydantic import Field, model_validator

from magmatch.settings import Settings

PriorName = Literal["auto", "spline", "divergence_free", "curl_free", "harmonic"]


class FieldConfig(Settings):
    """Settings of the field inference; what is None is chosen from the data."""

    # Which law and basis: 'auto', the one that predicts held-out data best, of 'spline' (soft div B = 0, sparse),
    # 'divergence_free' (published), 'curl_free' (potential) and 'harmonic' (no source in the region).
    prior: PriorName = "auto"
    # Distance over which the field changes, m. None: chosen from the data.
    lengthscale: float | None = Field(default=None, gt=0)
    # Prior standard deviation of one field component, T. None: chosen from the data.
    signal_sd: float | None = Field(default=None, gt=0)
    # Standard deviation of one measured component, T. None: chosen from the data.
    noise_sd: float | None = Field(default=None, gt=0)
    # Distance of the basis nodes, m. None: from the lengthscale and the size of the region.
    spacing: float | None = Field(default=None, gt=0)
    # Standard deviation of the biases of the logs' sensors, T, which are solved with the field; 0: they have none.
    # None: chosen from the data.
    sensor_bias_sd: float | None = Field(default=None, ge=0)
    # Leave out the few samples that contradict their neighbours, with a warning.
    leave_out_outliers: bool = True
    # Box outside which the map gives only its prior: (x0, y0, z0, x1, y1, z1), m, frame of the survey the map
    # is made from. None: as far as the samples inform the basis, about one lengthscale beyond them.
    domain: tuple[float, float, float, float, float, float] | None = None
    # If 'auto' compared priors: typical error of each on held-out data, T. An outcome, for the record.
    comparison: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        if self.domain is not None and not all(
            low < high for low, high in zip(self.domain[:3], self.domain[3:], strict=True)
        ):
            msg = f"domain: expected x0 < x1, y0 < y1, z0 < z1, got {self.domain}"
            raise ValueError(msg)
        return self


# For maps that another task makes on its way: the spline suits every place, costs least, and is what their numbers
# were fitted with.
SPLINE = FieldConfig(prior="spline")
