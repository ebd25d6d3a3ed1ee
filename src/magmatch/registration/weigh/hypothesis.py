# SPDX-License-Identifier: BSD-3-Clause
"""What is known of one pose when it comes to a decision, whatever it was weighed by."""

from typing import Literal, Protocol

from scipy.spatial.transform import RigidTransform

from magmatch.typing import Covariance6, Vector3

Kind = Literal["map", "walk", "log"]


class Hypothesis(Protocol):
    """One pose, refined and weighed against the null model; frames are those of the models compared."""

    @property
    def kind(self) -> Kind:
        """What gave the evidence: cells of a map, bins along a walk, or bins of a log that is followed."""

    @property
    def T_base_target(self) -> RigidTransform:
        """The pose."""

    @property
    def center(self) -> Vector3:
        """Point of the target about which the covariance is stated, m."""

    @property
    def covariance(self) -> Covariance6 | None:
        """As far as the comparison leaves the pose free; None where it fixes none."""

    @property
    def log_evidence(self) -> float:
        """For this pose over the null model, the search over all poses paid, nats."""

    @property
    def attainable(self) -> float:
        """The same, had the base explained the target to the noise, nats."""

    @property
    def misfit(self) -> float:
        """Normalised rms of the residuals: 1 where the noise and the map's spread explain them."""

    @property
    def overlap(self) -> float:
        """Share of the target inside the base map."""
