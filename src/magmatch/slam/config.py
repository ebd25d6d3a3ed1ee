# SPDX-License-Identifier: BSD-3-Clause
"""Settings of slam and merge."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from magmatch.data.geodesy import MOST_LATITUDE, MOST_LONGITUDE
from magmatch.preparation.odometry.drift import Drift, OdometryConfig
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.settings import Settings
from magmatch.typing import Indices

# What closures are believed by, beside the law of `estimation/posterior.py`.
# Probability that a registration needs: so sure is the graph of a place that it knows, and what teaches noise.
SURE = DecisionConfig().min_probability
# Probability above which a closure is kept: it is more likely right than wrong.
LEAST_KEPT = 0.5
# Largest log odds of a closure, nats: with more, it could never be rejected.
MOST_ODDS = 12.0
# Share of a closure's covariance that is each window's own: how its path bends, what its sensor saw. Errors of
# simulated closures correlate by so much where they share a window.
COMMON = 1 / 3
# Passes that a window is compared with. Its closures have an error in common, so n of them tell 3 n / (n + 1) times
# what one tells (`counted`): four tell four fifths of all.
MOST_PASSES = 4

Latitude = Annotated[float, Field(ge=-MOST_LATITUDE, le=MOST_LATITUDE, allow_inf_nan=False)]
Longitude = Annotated[float, Field(ge=-MOST_LONGITUDE, le=MOST_LONGITUDE, allow_inf_nan=False)]


class SlamConfig(Settings):
    """Everything that shapes slam, stage by stage."""

    odometry: OdometryConfig = Field(default_factory=OdometryConfig)
    # Standard deviations of single logs, by name, where they differ from `odometry.sd`.
    sd_of_logs: dict[str, Drift] = Field(default_factory=dict)
    # Whether z is up in the odometry's frames, and whether all poses lie at one height too.
    is_gravity_aligned: bool = True
    is_planar: bool = False
    # Latitude and longitude (deg) at which x and y are 0, for fixed points in degrees. By default, the first of them.
    origin: tuple[Latitude, Longitude] | None = None
    # Length of a window, in field lengths: long against the field's changes, short against the odometry's drift.
    window_length: float = Field(default=6.0, gt=0)
    # Probability that a window revisits a place, and that its neighbour then does too.
    revisit_share: float = Field(default=0.5, gt=0, lt=1)
    keeps_on: float = Field(default=0.8, gt=0, lt=1)

    @property
    def drifts(self) -> Indices:
        """Components of a pose that odometry lets drift, rotation first: gravity and the floor hold the others."""
        if not self.is_gravity_aligned:
            return np.arange(6)
        return np.array([2, 3, 4] if self.is_planar else [2, 3, 4, 5])

    @property
    def run_length(self) -> int:
        """Number of windows in a row that lie near where the one before did, on average."""
        return round(1 / (1 - self.keeps_on))

    def sd_stated(self, name: str) -> tuple[float, float] | None:
        """The drift that is stated of one log, by its name or the stem of that."""
        return self.sd_of_logs.get(name, self.sd_of_logs.get(Path(name).stem))

    def odometry_of(self, name: str) -> OdometryConfig:
        """Settings of one log's odometry."""
        sd = self.sd_stated(name)
        return self.odometry if sd is None else self.odometry.model_copy(update={"sd": sd})
