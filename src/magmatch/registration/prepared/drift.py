# SPDX-License-Identifier: BSD-3-Clause
"""Position errors correlated along the path: their effect on residuals and on the pose.

A survey states how accurate its own positions are. Independent errors show in the residuals; errors correlated along
the path do not, since the pose follows them, so they must be added to the covariance (`covariance.py`).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtri

from magmatch.data.survey import Survey
from magmatch.estimation.cubes import even_choice
from magmatch.estimation.limits import FEW_POINTS, MOST_POINTS
from magmatch.estimation.pose_prior import RARE
from magmatch.field.folds import has_path_order
from magmatch.field.values import FieldFunction, gradient_norm, gradient_of
from magmatch.geometry import path_walked
from magmatch.typing import Indices, Matrix, Points, Scalars, Tensors, Vectors

# Positions of dead reckoning wander: about their own mean, their correlation length is this share of the path.
CORRELATION_SHARE = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Drift:
    """Errors of the positions of a survey's samples."""

    sd: float  # m: of each coordinate, as the survey states it; 0 where it states none
    lasting_sd: float  # m: the part that lasts: of covariance ``sd^2 exp(-d / length)``, d along the path
    stretch: Indices  # (n,) ints: stretch of path that each sample lies in
    correlation: Matrix  # (s, s): of the stretches' errors

    @classmethod
    def of(cls, survey: Survey, posterior: FieldFunction) -> "Drift":
        """The correlated part of a stated accuracy: without the independent errors that the samples show."""
        positions, pose_sd = survey.positions, survey.pose_sd
        if not (pose_sd > 0 and has_path_order(positions)):
            return cls(pose_sd, 0.0, np.zeros(len(positions), dtype=np.int64), np.zeros((1, 1)))
        lasting_sd = float(np.sqrt(max(pose_sd**2 - white_variance(positions, survey.field, posterior), 0.0)))
        walked = path_walked(positions)
        side = walked[-1] / FEW_POINTS
        stretch = (walked / side).astype(np.int64)
        ends = np.arange(stretch[-1] + 1, dtype=np.float64)[:, None]
        return cls(pose_sd, lasting_sd, stretch, np.exp(-cdist(ends, ends) / (CORRELATION_SHARE * FEW_POINTS)))

    def together(self, other: "Drift") -> "Drift":
        """Errors of these samples and of those that they are compared with, as if correlated along this path."""
        return replace(self, lasting_sd=float(np.hypot(self.lasting_sd, other.lasting_sd)))

    def score_covariance(self, weighted: np.ndarray, gradient: Tensors, rows: Indices) -> Matrix:
        """Covariance of the sum of the samples' scores through their positions."""
        p = weighted.shape[2]
        if not self.lasting_sd:
            return np.zeros((p, p))
        pushes = np.einsum("nip,nij->njp", weighted, gradient).reshape(len(rows), -1)
        sums = np.zeros((len(self.correlation), 3 * p))
        np.add.at(sums, self.stretch[rows], pushes)
        by_axis = sums.reshape(-1, 3, p)
        return np.asarray(
            self.lasting_sd**2 * np.einsum("sjp,st,tjq->pq", by_axis, self.correlation, by_axis, optimize=True)
        )


def field_variance(gradient: Tensors, position_variance: float) -> Scalars:
    """Variance of one field component due to position errors, T^2."""
    return np.asarray(position_variance / 3 * gradient_norm(gradient) ** 2)


def white_variance(positions: Points, field: Vectors, posterior: FieldFunction) -> float:
    """Variance of position errors that neighbours on a path do not share, if it is significant."""
    first = even_choice(len(positions) - 1, MOST_POINTS)
    # Most samples are in two pairs.
    rows, places = np.unique(np.concatenate([first, first + 1]), return_inverse=True)
    values, (one, other) = posterior.evaluate(positions[rows], order=1), places.reshape(2, -1)
    steps2 = ((field[first + 1] - values.field[other] - field[first] + values.field[one]) ** 2).sum(axis=1)
    steepness2 = gradient_norm(gradient_of(values)) ** 2
    power = steepness2[one] + steepness2[other]
    X = np.stack([np.ones(len(steps2)), power], axis=1)
    scale = X.mean(axis=0)
    if not (scale[1] > 0 and steps2.any()):
        return 0.0
    X, expected = X / scale, np.full(len(steps2), steps2.mean())
    for _ in range(3):
        # The standard deviation of a square is proportional to its expectation.
        W = X / expected[:, None] ** 2
        C = np.linalg.pinv(W.T @ X, hermitian=True)
        a = C @ (W.T @ steps2)
        expected = np.maximum(X @ np.maximum(a, 0.0), 0.05 * steps2.mean())
    scatter = float((((steps2 - X @ a) / expected) ** 2).mean())
    is_sure = a[1] > ndtri(1 - RARE) * np.sqrt(scatter * C[1, 1])
    return float(a[1] / scale[1]) if is_sure else 0.0
