# SPDX-License-Identifier: BSD-3-Clause
"""The spline model of a region: a single model if one factor can hold the region, tiles otherwise."""

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import count_active_cells, lay_cells
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index, Posterior, StoredTile
from magmatch.field.tiles.tiled_model import TiledModel
from magmatch.field.tiles.whole_model import WholeModel
from magmatch.typing import Points, Vectors

# What one factor may cost: floating-point operations (about a second), and cells of the region and of the box around
# it that are worth looking at to count them.
MOST_OPERATIONS, MOST_CELLS, MOST_BOX_CELLS = 3e10, 30_000, 4e6


def lay_splines(points: Points, hyperparameters: Hyperparameters) -> WholeModel | TiledModel:
    """Model of the surroundings of points."""
    spacing = hyperparameters.spacing
    n_active, n_box = count_active_cells(points, spacing, hyperparameters.reach, MOST_BOX_CELLS)
    if n_box <= MOST_BOX_CELLS and n_active <= MOST_CELLS:
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


def tiles_to_store(posterior: Posterior, points: Points, field: Vectors) -> dict[Index, StoredTile]:
    """What to store of a posterior of these samples, so that it need not be fitted again; of other priors nothing."""
    weights = posterior.weights_by_tile
    if not weights:
        return {}
    tasks = lay_splines(points, posterior.hyperparameters).tasks_of(points, field)
    return {i: StoredTile(w, tasks.fingerprint(i)) for i, w in weights.items()}
