# SPDX-License-Identifier: BSD-3-Clause
"""A region of any size as overlapping tiles, each an independent spline model: cost and memory follow the area.

Information is kept as samples, since the Gram matrices of a large area would not fit in memory: they add, and are
summed tile by tile when the posterior is asked for. Only the weights of a tile stay; its factor is made again from
its samples where a covariance is asked for.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.tiles.recent import Recent
from magmatch.field.tiles.tile_fit import Samples, TileTask, fit_weights
from magmatch.field.tiles.tile_tasks import TileTasks
from magmatch.field.tiles.tiled_posterior import FACTORED_BYTES, TiledPosterior
from magmatch.field.tiles.tiles import Index, Tiling
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Indices, Points, Scalars, Vectors

# Applies a function to every task, results in the order of the tasks.
Runner = Callable[[Callable[[TileTask], Scalars], Iterable[TileTask]], Iterable[Scalars]]


@dataclass(frozen=True, eq=False, slots=True)
class TiledInformation:
    """What samples say about all tiles: the samples themselves, with the sign with which they count."""

    parts: tuple[Samples, ...]

    def __add__(self, other: "TiledInformation") -> "TiledInformation":
        """Information of both data sets."""
        return TiledInformation(self.parts + other.parts)

    def __sub__(self, other: "TiledInformation") -> "TiledInformation":
        """Take off information that was counted twice."""
        return TiledInformation(self.parts + tuple(replace(p, sign=-p.sign) for p in other.parts))


@dataclass(frozen=True, eq=False, slots=True)
class TiledModel:
    """Spline models over the tiles near given points, with fixed hyperparameters.

    Attributes
    ----------
    tiles : list of indices
        In ascending order.
    points : (n, 3) array, m
        What the cells are laid around.
    rows : list of int arrays
        Which of the points each tile sees.
    """

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

    def observe(self, points: Points, field: Vectors, weights: Scalars | None = None) -> TiledInformation:
        """Information in samples; those outside of all tiles say nothing."""
        weight = np.ones(len(points)) if weights is None else np.asarray(weights, dtype=np.float64)
        return TiledInformation((Samples(points, np.asarray(field, dtype=np.float64), weight),))

    def infer(
        self, information: TiledInformation, known: Mapping[Index, Scalars] | None = None, run: Runner = map
    ) -> TiledPosterior:
        """Posterior given information."""
        return self.infer_tasks(self.tasks(information), known or {}, run)

    def infer_tasks(self, tasks: TileTasks, known: Mapping[Index, Scalars], run: Runner = map) -> TiledPosterior:
        """Fit those tiles that are not known yet; see `infer`."""
        found, factored = dict(known), Recent(FACTORED_BYTES)
        numbers = [k for k, index in enumerate(self.tiles) if index not in found]
        if run is map:
            # Outliers and draws ask for the factors next: made here, some of them stay.
            fitted: Iterable[Scalars] = side_by_side(partial(_fit_here, tasks, factored), numbers)
        else:
            fitted = run(fit_weights, map(tasks.task, numbers)) if numbers else ()
        for k, weights in zip(numbers, fitted, strict=True):
            found[self.tiles[k]] = weights
        return TiledPosterior(tasks, [found[index] for index in self.tiles], factored)

    def tasks(self, information: TiledInformation) -> TileTasks:
        """What the fit of each tile depends on."""
        rows = [
            self.rows if part.points is self.points else self.tiling.assign(part.points, self.tiles)
            for part in information.parts
        ]
        return TileTasks(
            self.hyperparameters, self.tiling, self.tiles, self.points, self.rows, information.parts, rows
        )


@single_threaded
def _fit_here(tasks: TileTasks, factored: Recent, number: int) -> Scalars:
    """What `fit_weights` gives of a tile, whose factor is offered to those who want it later."""
    posterior = tasks.task(number).infer()
    factored.offer(number, posterior)
    return posterior.weights
