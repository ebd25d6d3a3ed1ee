# SPDX-License-Identifier: BSD-3-Clause
"""Whether field vectors are consistent with one place: what no map explains, and its errors on held-out samples."""

import logging
from dataclasses import replace

import numpy as np

from magmatch.field.cholesky.cells import count_active_cells
from magmatch.field.cholesky.multifrontal import Factors, factorise
from magmatch.field.folds import path_segments
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_layout import COARSER
from magmatch.field.spline.spline_kernels import right_hand_sides
from magmatch.field.spline.spline_model import SplineModel, SplinePosterior
from magmatch.field.tiles.region_model import MOST_OPERATIONS
from magmatch.typing import Points, Scalars, Tensors, Vectors

log = logging.getLogger(__name__)

# Stretches left out of a map; long enough that their ends do not predict their middle.
STRETCH_IN_LENGTHSCALES = 3.0
# Splines lie this many to a lengthscale: closer ones are for maps, cost most of the time and change estimates by less
# than their errors.
LENGTHSCALE_IN_SPACINGS = 2.5
# Cells of a map in one piece, which at 8 kB each take half a gigabyte with their factor.
MOST_CELLS = 60_000


def affordable(points: Points, hyperparameters: Hyperparameters) -> Hyperparameters:
    """The settings, coarsened until a map of the points in one piece takes about a second and bounded memory.

    Samples as close as motion capture gives them ask for lengths far below the distance between passes of a place.
    """
    h = hyperparameters
    h = replace(h, spacing=max(h.spacing, h.lengthscale / LENGTHSCALE_IN_SPACINGS))
    while not _is_affordable(points, h):
        spacing = COARSER * h.spacing
        h = replace(h, spacing=spacing, lengthscale=max(h.lengthscale, LENGTHSCALE_IN_SPACINGS * spacing))
    if h.lengthscale > hyperparameters.lengthscale:
        words = "a map in detail of %.2g m is too large, %.2g m are taken; --thin METRES takes fewer samples"
        log.warning(words, hyperparameters.lengthscale, h.lengthscale)
    return h


def _is_affordable(points: Points, h: Hyperparameters) -> bool:
    """Whether one factor holds a map, estimated before any of its memory is taken."""
    if count_active_cells(points, h.spacing, h.reach) > MOST_CELLS:
        return False
    return SplineModel.over(points, h).elimination.n_operations <= MOST_OPERATIONS


class MapConsistency:
    """The part of fields that no map of the place explains, for any number of fields at the same points."""

    def __init__(self, points: Points, hyperparameters: Hyperparameters, weights: Scalars) -> None:
        self.points, self.weights = points, weights
        self._model = SplineModel.over(points, hyperparameters)
        empty = self._model.observe(points, np.zeros_like(points), weights)
        self._factor = factorise(self._model.elimination, empty.gram + self._model.prior_precision())

    def project(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (k, n, 3), weighted, and what the best map leaves of each: a `Projection`.

        With weights W, basis Phi and prior precision P0 in units of the noise: ``(I - Phi (Phi'W Phi + P0)^-1
        Phi'W) c`` for each column c; ``c'W`` times it is the quadratic form of the marginal likelihood.
        """
        left = np.asarray(columns * self.weights[:, None])
        return left, np.asarray(columns - self._explained(columns, order=0)[0])

    def gradient(self, field: Vectors) -> Tensors:
        """Gradient of the best map of a field, at its own samples: (n, 3, 3), T/m."""
        return np.asarray(self._explained(field[None], order=1)[1][0])

    def _explained(self, columns: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        weighted = np.moveaxis(columns * self.weights[:, None], 0, 2)
        solved = self._factor.solve(right_hand_sides(self._model.cells, self.points, weighted))
        values, gradients = [], []
        for w in solved.T:
            posterior = SplinePosterior(
                self._model.hyperparameters, self._model.cells, Factors.of(self._factor), np.ascontiguousarray(w)
            )
            found = posterior.evaluate(self.points, order)
            values.append(found.field)
            gradients.append(np.zeros((0, 3, 3)) if found.gradient is None else found.gradient)
        return np.stack(values), np.stack(gradients)


def held_out_error(points: Points, field: Vectors, hyperparameters: Hyperparameters) -> float:
    """Median error of a map on samples held out stretch by stretch."""
    stretch = path_segments(points, STRETCH_IN_LENGTHSCALES * hyperparameters.lengthscale)
    model, misses = SplineModel.over(points, hyperparameters), []
    for fold in range(2):
        out = stretch % 3 == fold
        posterior = model.infer_in_single_precision(model.observe(points[~out], field[~out]))
        misses.append(np.linalg.norm(posterior.evaluate(points[out]).field - field[out], axis=1))
    return float(np.median(np.concatenate(misses)))
