# SPDX-License-Identifier: BSD-3-Clause
"""One spline model where one factor can hold the region, tiles where not; fits that were stored are recalled."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import count_active_cells, lay_cells
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_model import SplineModel, SplinePosterior
from magmatch.field.tiles.tile_fit import Samples, fit_weights
from magmatch.field.tiles.tile_tasks import TileTasks
from magmatch.field.tiles.tiled_model import Runner, TiledModel
from magmatch.field.tiles.tiled_posterior import TiledPosterior
from magmatch.field.tiles.tiles import Index
from magmatch.typing import Points, Scalars, Vectors

WHOLE: Index = (0, 0, 0)
# What one factor may cost: floating-point operations (about a second), and cells of the region and of the box around
# it that are worth looking at to count them.
MOST_OPERATIONS, MOST_CELLS, MOST_BOX_CELLS = 3e10, 30_000, 4e6
# Tiles that stand for all when the cost of a fit is estimated.
N_WEIGHED_TILES = 9


@dataclass(frozen=True, slots=True, eq=False)
class StoredTile:
    """Weights of a tile as an earlier fit gave them, and the fingerprint of what they were fitted from."""

    weights: Scalars
    fingerprint: str


def lay_splines(points: Points, hyperparameters: Hyperparameters) -> SplineModel | TiledModel:
    """Model of the surroundings of points."""
    spacing = hyperparameters.spacing
    n_active, n_box = count_active_cells(points, spacing, hyperparameters.reach, MOST_BOX_CELLS)
    if n_box <= MOST_BOX_CELLS and n_active <= MOST_CELLS:
        cells = lay_cells(points, spacing, hyperparameters.reach)
        elimination = order_elimination(cells)
        if elimination.n_operations <= MOST_OPERATIONS:
            return SplineModel(hyperparameters, cells, elimination)
    return TiledModel.over(points, hyperparameters)


def fit_operations(points: Points, hyperparameters: Hyperparameters) -> float:
    """Estimate the floating-point operations of a fit, without fitting; about 3e10 of them take a second.

    Parameters
    ----------
    points : (n, 3) array, m
    hyperparameters : Hyperparameters
        Only spacing and lengthscale matter.

    Returns
    -------
    float
        Infinite where the region is refused.
    """
    try:
        model = lay_splines(points, hyperparameters)
    except ConfigurationError:
        return np.inf
    if isinstance(model, SplineModel):
        return model.elimination.n_operations
    some = np.unique(np.linspace(0, len(model.tiles) - 1, N_WEIGHED_TILES).astype(np.int64))
    tasks = tasks_of(model, points, points)
    return len(model.tiles) * float(np.mean([tasks.task(k).model().elimination.n_operations for k in some]))


def fit_splines(
    model: SplineModel | TiledModel,
    points: Points,
    field: Vectors,
    stored: Mapping[Index, StoredTile] | None = None,
    run: Runner = map,
) -> SplinePosterior | TiledPosterior:
    """Fit samples, but for tiles whose fit is stored already."""
    if not stored and isinstance(model, SplineModel):
        return model.infer_lightly(model.observe(points, field))
    tasks = tasks_of(model, points, field)
    known = {i: tile.weights for i, tile in (stored or {}).items() if tile.fingerprint == tasks.fingerprint(i)}
    if isinstance(model, TiledModel):
        return model.infer_tasks(tasks, known, run)
    weights = known[WHOLE] if WHOLE in known else next(iter(run(fit_weights, [tasks.task(0)])))
    return tasks.task(0).recall(weights)


def tiles_of(posterior: SplinePosterior | TiledPosterior, points: Points, field: Vectors) -> dict[Index, StoredTile]:
    """What to store of a posterior of these samples, so that it need not be fitted again."""
    tasks = tasks_of(lay_splines(points, posterior.hyperparameters), points, field)
    weights = posterior.tile_weights if isinstance(posterior, TiledPosterior) else [posterior.weights]
    return {i: StoredTile(w, tasks.fingerprint(i)) for i, w in zip(tasks.tiles, weights, strict=True)}


def tasks_of(model: SplineModel | TiledModel, points: Points, field: Vectors) -> TileTasks:
    """What the weights of each tile follow from."""
    if isinstance(model, TiledModel):
        return model.tasks(model.observe(points, field))
    samples, every = Samples(points, field, np.ones(len(points))), [np.arange(len(points))]
    return TileTasks(model.hyperparameters, None, [WHOLE], points, every, (samples,), [every])
