# SPDX-License-Identifier: BSD-3-Clause
"""A weighed pose as the decision needs it, whatever it was weighed by."""

from collections.abc import Iterable
from typing import Literal, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.typing import Covariance6, Vector3

Kind = Literal["map", "walk", "log", "window"]


class Hypothesis(Protocol):
    """One pose, refined and weighed against the null model; frames are those of the models compared."""

    @property
    def kind(self) -> Kind:
        """The kind of evidence: from cells of a map, bins along a walk, of a live log, or of a window of a path."""

    @property
    def model(self) -> str:
        """Under which model it was weighed; the poses of one model are rivals, the models of one pose are not."""

    @property
    def T_base_target(self) -> RigidTransform:
        """The pose."""

    @property
    def center(self) -> Vector3:
        """Point of the target about which the covariance is stated, m."""

    @property
    def covariance(self) -> Covariance6 | None:
        """Covariance from the comparison of the fields; None if they do not determine the pose."""

    @property
    def log_evidence(self) -> float:
        """Evidence for this pose against the null model, with the penalty for the search over all poses, nats."""

    @property
    def attainable(self) -> float:
        """The evidence if the base explained the target up to noise, nats."""

    @property
    def misfit(self) -> float:
        """Normalised rms of the residuals: 1 where the noise and the map's spread explain them."""

    @property
    def overlap(self) -> float:
        """Share of the target inside the base map."""


H = TypeVar("H", bound=Hypothesis)


def in_order(found: Iterable[H | None]) -> list[H]:
    """Those that exist, with most evidence first."""
    return sorted((one for one in found if one is not None), key=lambda one: -one.log_evidence)


def worst_sd(covariance: Covariance6) -> tuple[float, float]:
    """Standard deviation in the worst direction, of the place (m) and of the turn (rad)."""
    turn, shift = np.linalg.eigvalsh(np.stack([covariance[:3, :3], covariance[3:, 3:]]))[:, -1].tolist()
    return np.sqrt(max(shift, 0.0)), np.sqrt(max(turn, 0.0))
