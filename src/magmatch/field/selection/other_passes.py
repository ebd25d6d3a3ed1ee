# SPDX-License-Identifier: BSD-3-Clause
"""What one pass of a path misses of another: stretches are left out and predicted from the rest.

Only other passes and the prior can predict a stretch, so their errors hold what a map for other surveys must reckon
with: poses that drift, and structure between the lanes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.folds import folds_of, path_stretches
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.threads import side_by_side
from magmatch.typing import Mask, Vectors

# Half of what is left out, nearest to other passes, counts; the rest crosses none and tells nothing. Of their errors
# the mean of the roots is taken, so that the few that nothing could predict do not drown the others.
SHARE, POWER = 0.5, 0.5
INFLATIONS = np.geomspace(1.3, 8.0, 13)


@dataclass(frozen=True, eq=False, slots=True)
class Misses:
    """What predictions of left-out stretches missed them by.

    Attributes
    ----------
    errors : (n, 3) array, T
    variances : (n, 3) array, T^2
        Of the predictions.
    is_near : (n,) bool array
        Where other passes are near.
    """

    errors: Vectors
    variances: Vectors
    is_near: Mask

    @property
    def size(self) -> float:
        """Level of one component's error where other passes are near, T."""
        size = np.linalg.norm(self.errors[self.is_near], axis=1)
        return float((size**POWER).mean() ** (1 / POWER) / np.sqrt(3))

    def inflation(self, noise_sd: float) -> float:
        """Factor on the posterior's standard deviation for which 95 % intervals cover 95 % of what was left out."""
        away, v = np.abs(self.errors), self.variances
        covered = [(away <= 1.96 * np.sqrt(noise_sd**2 + f**2 * v)).mean() >= 0.95 for f in INFLATIONS]
        return float(INFLATIONS[np.argmax(covered) if any(covered) else -1])


class OtherPasses:
    """Stretches of a path, left out and predicted from the rest."""

    def __init__(self, search: EvidenceSearch, lengthscale: float) -> None:
        self._search, points = search, search.points
        self._folds = folds_of(path_stretches(points, lengthscale))
        distance = [cKDTree(points[~fold]).query(points[fold])[0] for fold in self._folds]
        together = np.concatenate([*distance, np.zeros(0)])
        self._is_near = together <= (np.quantile(together, SHARE) if len(together) else 0.0)

    @property
    def tell_something(self) -> bool:
        """Whether any stretch can be left out."""
        return bool(self._folds)

    def misses(self, h: Hyperparameters) -> Misses:
        """Predict every stretch that is left out."""

        def predict(fold: Mask) -> tuple[Vectors, Vectors]:
            posterior, x = self._search.fit_without(fold, h), self._search.points[fold]
            error = posterior.evaluate(x).field - self._search.field[fold]
            return error, np.diagonal(posterior.covariance(x), axis1=1, axis2=2)

        errors, variances = zip(*side_by_side(predict, self._folds), strict=True)
        return Misses(np.concatenate(errors), np.concatenate(variances), self._is_near)
