# SPDX-License-Identifier: BSD-3-Clause
"""What one pass of a path misses of another: stretches are left out and predicted from the rest.

Only other passes and the prior can predict a stretch, so their errors hold what a map for other surveys must reckon
with: poses that drift, and structure between the lanes.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.held_out import folds_of, path_stretches
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline_model import SplineModel, SplinePosterior
from magmatch.typing import Points, Vectors

# Half of what is left out, nearest to other passes, counts; the rest crosses none and tells nothing. Of their errors
# the mean of the roots is taken, so that the few that nothing could predict do not drown the others.
SHARE, POWER = 0.5, 0.5
INFLATIONS = np.geomspace(1.3, 8.0, 13)


class OtherPasses:
    """Stretches of a path, left out and predicted from the rest.

    Parameters
    ----------
    points : (n, 3) array, m
        Along the path.
    field : (n, 3) array, T
    lengthscale : float, m
        Over which the field changes.
    """

    def __init__(self, points: Points, field: Vectors, lengthscale: float) -> None:
        self.points, self.field = points, field
        self._folds = folds_of(path_stretches(points, lengthscale))
        distance = [cKDTree(points[~fold]).query(points[fold])[0] for fold in self._folds]
        together = np.concatenate([*distance, np.zeros(0)])
        self._is_near = together <= (np.quantile(together, SHARE) if len(together) else 0.0)

    @property
    def tell_something(self) -> bool:
        """Whether any stretch can be left out."""
        return bool(self._folds)

    def error(self, h: Hyperparameters) -> float:
        """Level of one component's error where other passes are near, T."""
        errors = np.concatenate([posterior.evaluate(x).field - b for posterior, x, b in self._fits(h)])
        size = np.linalg.norm(errors[self._is_near], axis=1)
        return float((size**POWER).mean() ** (1 / POWER) / np.sqrt(3))

    def inflation(self, h: Hyperparameters, noise_sd: float) -> float:
        """Factor on the posterior's standard deviation for which 95 % intervals cover 95 % of what was left out."""
        size, variance = [], []
        for posterior, x, b in self._fits(h):
            size.append(np.abs(posterior.evaluate(x).field - b))
            variance.append(np.diagonal(posterior.covariance(x), axis1=1, axis2=2))
        away, v = np.concatenate(size), np.concatenate(variance)
        covered = [(away <= 1.96 * np.sqrt(noise_sd**2 + f**2 * v)).mean() >= 0.95 for f in INFLATIONS]
        return float(INFLATIONS[np.argmax(covered) if any(covered) else -1])

    def _fits(self, h: Hyperparameters) -> Iterator[tuple[SplinePosterior, Points, Vectors]]:
        """Posterior from the samples outside of each fold, and what is left out."""
        model = SplineModel.over(self.points, h)
        for fold in self._folds:
            yield (
                model.infer(model.observe(self.points[~fold], self.field[~fold])),
                self.points[fold],
                self.field[fold],
            )
