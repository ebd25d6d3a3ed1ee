# SPDX-License-Identifier: BSD-3-Clause
"""The spline model of a region: a single model if one factor can hold the region, tiles otherwise.

Information is stored as samples, since the Gram matrices of a large area would not fit in memory: they are summed
tile by tile when the posterior is needed. Only the weights of a tile are kept; its factor is computed again from its
samples if a covariance is needed.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import count_active_cells
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import FieldPosterior, Index, StoredTile
from magmatch.field.spline.spline_model import WHOLE, SplineModel, SplinePosterior
from magmatch.field.tiles.tile_fit import Samples, TileCache, TileTasks, fit_weights
from magmatch.field.tiles.tiled_posterior import TiledPosterior
from magmatch.field.tiles.tiles import Tiling
from magmatch.progress import tell
from magmatch.runner import Runner, Workers
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Indices, Points, Scalars, Vectors

# Bytes of factors that are kept: so many, and one more tile's of at most 0.3 GB.
FACTORED_BYTES = 8e8
# Tiles that stand for all when the cost of a fit is estimated.
N_WEIGHED_TILES = 9
# What one factor may cost: floating-point operations (about a second), and cells of the region and of the box around
# it that are worth looking at to count them.
MOST_OPERATIONS, MOST_CELLS, MOST_BOX_CELLS = 3e10, 30_000, 4e6


@dataclass(frozen=True, eq=False, slots=True)
class TiledInformation:
    """The samples' information on all tiles: the samples themselves, less those of all further parts."""

    parts: tuple[Samples, ...]

    def __sub__(self, other: "TiledInformation") -> "TiledInformation":
        """Leave samples out, of which none is left out itself."""
        (left_out,) = other.parts
        return TiledInformation((*self.parts, left_out))


@dataclass(frozen=True, eq=False, slots=True)
class TiledModel:
    """Spline models over the tiles (ascending) near given points, and which of the points each tile sees."""

    hyperparameters: Hyperparameters
    tiling: Tiling
    tiles: list[Index]
    points: Points
    rows: list[Indices]

    @classmethod
    def over(cls, points: Points, hyperparameters: Hyperparameters, tiling: Tiling | None = None) -> "TiledModel":
        """Lay tiles (of the usual sizes unless stated) over the surroundings of points."""
        tiling = tiling or Tiling.suited_to(hyperparameters)
        tiles = tiling.occupied(points)
        return cls(hyperparameters, tiling, tiles, points, tiling.assign(points, tiles))

    def observe(self, points: Points, field: Vectors) -> TiledInformation:
        """Information in samples; those outside of all tiles say nothing."""
        return TiledInformation(((points, np.asarray(field, dtype=np.float64)),))

    @property
    def n_operations(self) -> float:
        """Floating-point operations of a fit, estimated from some of the tiles."""
        some = np.unique(np.linspace(0, len(self.tiles) - 1, N_WEIGHED_TILES).astype(np.int64))
        tasks = self.tasks_of(self.points, self.points)
        return len(self.tiles) * float(np.mean([tasks.task(k).model().elimination.n_operations for k in some]))

    def infer(self, information: TiledInformation) -> TiledPosterior:
        """Posterior given information."""
        return self._infer_tasks(self.tasks(information), {}, None)

    def fit(
        self, points: Points, field: Vectors, stored: Mapping[Index, StoredTile], run: Workers | None, /
    ) -> TiledPosterior:
        """Fit samples, but for tiles whose very fit is stored."""
        tasks = self.tasks_of(points, field)
        known = {i: tile.weights for i, tile in stored.items() if tile.fingerprint == tasks.fingerprint(i)}
        return self._infer_tasks(tasks, known, run)

    def _infer_tasks(self, tasks: TileTasks, known: Mapping[Index, Scalars], run: Workers | None) -> TiledPosterior:
        """Fit those tiles that are not known yet."""
        found, factored = dict(known), TileCache(FACTORED_BYTES)
        numbers = [k for k, index in enumerate(self.tiles) if index not in found]
        n_fitted = count(1)

        def noted(weights: Scalars) -> Scalars:
            tell("fitting tiles", next(n_fitted) / len(numbers))
            return weights

        if run is None:
            # Outliers and draws ask for the factors next: made here, some of them stay.
            fitted: Iterable[Scalars] = side_by_side(lambda k: noted(_fit_here(tasks, factored, k)), numbers)
        else:
            fitted = map(noted, Runner(run)(fit_weights, (tasks.task(k).as_task for k in numbers))) if numbers else ()
        for k, weights in zip(numbers, fitted, strict=True):
            found[self.tiles[k]] = weights
        return TiledPosterior(tasks, [found[index] for index in self.tiles], factored)

    def tasks_of(self, points: Points, field: Vectors) -> TileTasks:
        """Give the task from which the weights of each tile follow."""
        return self.tasks(self.observe(points, field))

    def tasks(self, information: TiledInformation) -> TileTasks:
        """Give all that the fit of each tile depends on."""
        rows = [
            self.rows if points is self.points else self.tiling.assign(points, self.tiles)
            for points, _ in information.parts
        ]
        return TileTasks(
            self.hyperparameters, self.tiling, self.tiles, self.points, self.rows, information.parts, rows
        )


@single_threaded
def _fit_here(tasks: TileTasks, factored: TileCache, number: int) -> Scalars:
    """Do as `fit_weights` for a tile, whose factor is offered to those who want it later."""
    posterior = tasks.task(number).infer()
    factored.offer(number, posterior)
    return posterior.weights


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
    h = hyperparameters
    if count_active_cells(points, h.spacing, h.reach, MOST_BOX_CELLS) <= MOST_CELLS:
        model = WholeModel.over(points, h)
        if model.n_operations <= MOST_OPERATIONS:
            return model
    return TiledModel.over(points, h)


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
