# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the localisation in a known map; lengths in field lengths, over which the map's field changes."""

from math import radians
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from magmatch.estimation.posterior import RIGHT_WITHIN
from magmatch.preparation.odometry.drift import DEAD_RECKONING_SD, Drift, OdometryConfig
from magmatch.registration.decide.decision import SAME_SD_ROTATION, DecisionConfig
from magmatch.settings import Settings

# Drift of a robot's odometry, m and degrees after 10 m.
ODOMETRY_SD: Drift = (0.15, 2.0)


def _stated(given: Any) -> Any:
    """Odometry as slam has it states its drift."""
    return given.model_dump() if type(given) is OdometryConfig else given


class LogOdometryConfig(OdometryConfig):
    """Drift of a log's odometry, which follows from what gave its poses unless it is stated."""

    # None: that of a robot's or another device's odometry; of dead reckoning, that of a phone.
    sd: Drift | None = None  # type: ignore[assignment]  # a drift once it is settled

    @property
    def drift(self) -> Drift:
        """The standard deviations that are stated, or else those of a robot's odometry."""
        return ODOMETRY_SD if self.sd is None else self.sd


class LocalizerConfig(Settings):
    """Everything that shapes a localisation, stage by stage."""

    # Drift of the odometry; pedestrians' steps are up to a tenth longer or shorter than the average.
    odometry: Annotated[LogOdometryConfig, BeforeValidator(_stated)] = Field(default_factory=LogOdometryConfig)
    # Whether z is up in the map's frame and the odometry's, and whether the body keeps one height, the map's, too.
    is_gravity_aligned: bool = True
    is_planar: bool = False
    # Bias of the magnetometer, T: of one that was calibrated (beside what the sensors of the map's own logs had) and
    # of one that was not, alike probable beforehand; and how it drifts, T per root of a second.
    calibrated_bias_sd: float = Field(default=1e-6, gt=0)
    bias_sd: float = Field(default=30e-6, gt=0)
    bias_drift: float = Field(default=2e-8, ge=0)
    # Its gain against that of the map's sensor: two of one kind, each calibrated.
    gain_sd: float = Field(default=0.007, gt=0)
    # Path whose evidence counts, and path that it takes to begin a search: half of it lies between two searches.
    window: float = Field(default=8.0, gt=0)
    min_window: float = Field(default=1.5, gt=0)
    # Path of the latest evidence, by which a trusted hypothesis may be doubted.
    recent: float = Field(default=2.5, gt=0)
    # Path for which a place must stay known before it is stated: the evidence by which it may be doubted is then new.
    # With hindsight a fix is stated from its beginning.
    stands: float = Field(default=2.5, ge=0)
    # Distinct starts that a search refines, and hypotheses that are kept.
    n_starts: int = Field(default=80, ge=1)
    n_hypotheses: int = Field(default=16, ge=2)
    # Prior probability that the track is lost within the latest path: the body is carried elsewhere, or its sensor's
    # bias jumps.
    end_probability: float = Field(default=0.01, gt=0, lt=1)
    # Penalty of a hypothesis that is not trusted for each field length of path outside the map, nats; at most that of
    # a track that is lost: it came into the map.
    price_outside: float = Field(default=3.0, ge=0)
    # When a pose is stated: the decision of a registration. The body may well be elsewhere, and is asked for at every
    # step: at these odds a walk elsewhere is ever stated once in 1,600 (Ville's inequality), in 10 km once in 16. The
    # standard deviations tell rooms and directions of a building apart; who needs a finer pose asks for it.
    decision: DecisionConfig = Field(
        default_factory=lambda: DecisionConfig(
            prior_odds=1 / 16, max_sd_translation=2.0, max_sd_rotation=round(radians(30), 4)
        )
    )

    def settled(self, *, is_dead_reckoned: bool = False) -> "LocalizerConfig":
        """The settings for a log: the drift that none stated is that of what gave the poses."""
        if self.odometry.sd is not None:
            return self
        sd = DEAD_RECKONING_SD if is_dead_reckoned else self.odometry.drift
        return self.model_copy(update={"odometry": self.odometry.model_copy(update={"sd": sd})})

    def same(self, length: float) -> tuple[float, float]:
        """Within what two hypotheses are one answer (m, rad), given the field length (m): less than may be stated."""
        shift, _ = self.decision.tolerance(length)
        # A registration's heading moves more points than a body's.
        return shift, RIGHT_WITHIN * min(self.decision.max_sd_rotation, 2 * SAME_SD_ROTATION)
