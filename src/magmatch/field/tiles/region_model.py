# SPDX-License-Identifier: BSD-3-Clause
"""The spline model of a region: a single model if one factor can hold the region, tiles otherwise."""

from collections.abc import Mapping

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import count_active_cells, lay_cells
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, StoredTile
from magmatch.field.spline.spline_model import WHOLE, SplineModel, SplinePosterior
from magmatch.field.tiles.tile_fit import TileTasks, fit_weights
from magmatch.field.tiles.tiled_model import TiledModel
from magmatch.runner import Runner, Workers
from magmatch.typing import Points, Vectors

# What one factor may cost: floating-point operations (about a second), and cells of the region and of the box around
# it that are worth looking at to count them.
MOST_OPERATIONS, MOST_CELLS, MOST_BOX_CELLS = 3e10, 30_000, 4e6


class WholeModel(SplineModel):
    """Splines over a region in one piece; fits and stores like `TiledModel`."""

    __slots__ = ()

    @property
    def n_operations(self) -> float:
        """Floating-point operations of a fit."""
        return self.elimination.n_operations

    def fit(
        self, points: Points, field: Vectors, stored: Mapping[Index, StoredTile], run: Workers | None, /
    ) -> SplinePosterior:
        """Fit samples, or recall the very fit of them that is stored."""
        if not stored:
            return self.infer_in_single_precision(self.observe(points, field))
        task = self.tasks_of(points, field).task(0)
        is_same = WHOLE in stored and stored[WHOLE].fingerprint == task.fingerprint()
        return task.recall(stored[WHOLE].weights if is_same else next(Runner(run)(fit_weights, [task.as_task])))

    def tasks_of(self, points: Points, field: Vectors) -> TileTasks:
        """Give the tasks from which the weights follow."""
        every = [np.arange(len(points))]
        return TileTasks(self.hyperparameters, None, [WHOLE], points, every, ((points, field),), [every])


def lay_splines(points: Points, hyperparameters: Hyperparameters) -> WholeModel | TiledModel:
    """Model of the surroundings of points."""
    spacing = hyperparameters.spacing
    if count_active_cells(points, spacing, hyperparameters.reach, MOST_BOX_CELLS) <= MOST_CELLS:
        cells = lay_cells(points, spacing, hyperparameters.reach)
        elimination = order_elimination(cells)
        if elimination.n_operations <= MOST_OPERATIONS:
            return WholeModel(hyperparameters, cells, elimination)
    return TiledModel.over(points, hyperparameters)


def fit_operations(points: Points, hyperparameters: Hyperparameters) -> float:
    """Floating-point operations of a fit, about 3e10 a second; infinite where the region is refused."""
    try:
        return lay_splines(points, hyperparameters).n_operations
    except ConfigurationError:
        return np.inf


def tiles_to_store(posterior: FieldPosterior, points: Points, field: Vectors) -> dict[Index, StoredTile]:
    """Give what is stored of a posterior, so that it need not be fitted again; of other priors nothing."""
    weights = posterior.weights_by_tile
    if not weights:
        return {}
    tasks = lay_splines(points, posterior.hyperparameters).tasks_of(points, field)
    return {i: StoredTile(w, tasks.fingerprint(i)) for i, w in weights.items()}
