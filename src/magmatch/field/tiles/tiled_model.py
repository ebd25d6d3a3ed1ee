# SPDX-License-Identifier: BSD-3-Clause
"""A region of any size as overlapping tiles, each an independent spline model: cost and memory grow with the area.

Information is stored as samples, since the Gram matrices of a large area would not fit in memory: they are summed
tile by tile when the posterior is needed. Only the weights of a tile are kept; its factor is computed again from its
samples if a covariance is needed.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index, StoredTile
from magmatch.field.tiles.tile_cache import TileCache
from magmatch.field.tiles.tile_fit import Samples, TileTasks, fit_weights
from magmatch.field.tiles.tiled_posterior import FACTORED_BYTES, TiledPosterior
from magmatch.field.tiles.tiles import Tiling
from magmatch.progress import tell
from magmatch.runner import Runner, Workers
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Indices, Points, Scalars, Vectors

# Tiles that stand for all when the cost of a fit is estimated.
N_WEIGHED_TILES = 9


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
        h = hyperparameters
        tiling = tiling or Tiling.suited_to(h.lengthscale, h.spacing, h.reach)
        tiles = tiling.occupied(points)
        return cls(h, tiling, tiles, points, tiling.assign(points, tiles))

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
