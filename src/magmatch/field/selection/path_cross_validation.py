# SPDX-License-Identifier: BSD-3-Clause
"""Cross-validation along a path: stretches are held out and predicted from the rest.

Only other passes and the prior can predict a stretch, so these errors include what a map must expect of other
surveys: drifting poses, and structure between the lanes.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from magmatch.field.folds import COVERAGE, IN_SDS, folds_of, path_stretches
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.threads import side_by_side
from magmatch.typing import Mask, Vectors

# The half of what is left out that is nearest to other passes counts; the rest crosses none and tells nothing. The
# mean of the roots of their errors is taken, so that the few that nothing could predict do not dominate.
SHARE, POWER = 0.5, 0.5
INFLATIONS = np.geomspace(1.3, 8.0, 13)


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutErrors:
    """Errors (T) of predictions of held-out stretches, their variances (T^2), and where other passes are near."""

    errors: Vectors
    variances: Vectors
    is_near: Mask

    @property
    def size(self) -> float:
        """Size of one component's error where other passes are near, T."""
        size = np.linalg.norm(self.errors[self.is_near], axis=1)
        return float((size**POWER).mean() ** (1 / POWER) / np.sqrt(3))

    def inflation(self, noise_sd: float) -> float:
        """Factor on the posterior's standard deviation for which 95 % intervals cover 95 % of the held-out data."""
        size, v = np.abs(self.errors), self.variances
        covered = [(size <= IN_SDS * np.sqrt(noise_sd**2 + f**2 * v)).mean() >= COVERAGE for f in INFLATIONS]
        return float(INFLATIONS[np.argmax(covered) if any(covered) else -1])


def cross_validate_path(search: EvidenceSearch, h: Hyperparameters, lengthscale: float) -> HeldOutErrors | None:
    """Hold out stretches of a path, long relative to a lengthscale; None if none can be held out."""
    points, left_out = search.points, folds_of(path_stretches(search.points, lengthscale))
    if not left_out:
        return None

    def predict(fold: Mask) -> tuple[Vectors, Vectors]:
        posterior, x = search.fit_without(fold, h), points[fold]
        error = posterior.evaluate(x).field - search.field[fold]
        return error, np.diagonal(posterior.covariance(x), axis1=1, axis2=2)

    errors, variances = zip(*side_by_side(predict, left_out), strict=True)
    distance = np.concatenate([cKDTree(points[~fold]).query(points[fold])[0] for fold in left_out])
    return HeldOutErrors(np.concatenate(errors), np.concatenate(variances), distance <= np.quantile(distance, SHARE))


def expecting(h: Hyperparameters, evident_noise_sd: float, missed: HeldOutErrors) -> Hyperparameters:
    """Noise and spread that a map must expect of other surveys; the mean is unchanged.

    Along a path the nearest samples share their error: the errors of other passes exceed the noise found by the
    evidence. ``missed``: the errors of a posterior with that noise and without inflation.
    """
    noise = max(evident_noise_sd, missed.size)
    return replace(h.with_noise(noise), inflation=missed.inflation(noise) * evident_noise_sd / noise)
