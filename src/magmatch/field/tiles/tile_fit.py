# SPDX-License-Identifier: BSD-3-Clause
"""Tiles, each from its samples to its weights: the tasks of which large maps consist, the same wherever they run."""

import hashlib
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from functools import partial
from threading import Lock

import numpy as np

from magmatch.errors import MagmatchError
from magmatch.field.cholesky.cells import CellGrid, lay_cells
from magmatch.field.cholesky.multifrontal import CholeskyFactor, Factors
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index, is_refit
from magmatch.field.spline.spline_model import SplineInformation, SplineModel, SplinePosterior
from magmatch.field.tiles.tiles import Tiling
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Points, Scalars, Vectors
from magmatch.workers import Task

# At 2 MB each without their factor.
MOST_TILES = 64


class TileCache:
    """Keeps some things as they were made, and beside them the last few that were asked for."""

    def __init__(self, n_bytes: float = np.inf) -> None:
        self._n_bytes, self._lock = n_bytes / 2, Lock()
        self._offered: dict[int, SplinePosterior] = {}
        self._made = OrderedDict[int, SplinePosterior]()

    def find(self, number: int, make: Callable[[], SplinePosterior]) -> SplinePosterior:
        """Give what was made under a number, or else make it."""
        with self._lock:
            found = self._offered.get(number) or self._made.get(number)
            if number in self._made:
                self._made.move_to_end(number)
        if found is not None:
            return found
        # Without the lock: others may make theirs meanwhile.
        made = make()
        with self._lock:
            while self._made and self._is_full():
                self._made.popitem(last=False)
            self._made[number] = made
        return made

    def offer(self, number: int, posterior: SplinePosterior) -> None:
        """Keep what was made already, if there is room: whatever is asked in turn finds these at least."""
        with self._lock:
            if _n_bytes([*self._offered.values(), posterior]) <= self._n_bytes:
                self._offered[number] = posterior

    def _is_full(self) -> bool:
        return len(self._made) >= MOST_TILES or _n_bytes(self._made.values()) > self._n_bytes


def _n_bytes(posteriors: Iterable[SplinePosterior]) -> int:
    return sum(posterior.factors.n_bytes for posterior in posteriors)


# Changes with whatever lets the same samples and numbers give other weights: stored fits are then done again.
LAYOUT = "magmatch.tile/2"
# Position and field of samples in the model's frame.
Samples = tuple[Points, Vectors]


class FitError(MagmatchError, ValueError):
    """Stored weights do not follow from the stored samples."""

    def __init__(self, index: Index, message: str) -> None:
        super().__init__(
            f"tile {'.'.join(map(str, index))}: {message} (made by another version of magmatch?); build the map again"
        )


@dataclass(frozen=True, eq=False, slots=True)
class TileTask:
    """Everything that a tile's fit depends on."""

    hyperparameters: Hyperparameters
    tiling: Tiling | None  # None: one tile holds the whole region
    index: Index  # which tile
    around: Points  # (n, 3), m: samples that shape the tile's cells
    parts: list[Samples]  # samples that inform it, as far as they lie in its box, less those of all further parts

    @property
    def as_task(self) -> Task:
        """The tile as a runner takes it."""
        return Task("tile " + ".".join(map(str, self.index)), (self,))

    def fingerprint(self) -> str:
        """SHA-256 of everything that determines the weights."""
        sizes = None if self.tiling is None else astuple(self.tiling)
        about = (LAYOUT, sorted(self.hyperparameters.as_dict().items()), sizes, self.index)
        digest = hashlib.sha256(repr(about).encode())
        arrays = [self.around]
        for k, (points, field) in enumerate(self.parts):
            # How often each sample counts, and with which sign.
            arrays += [points, field, np.ones(len(points)), np.array(-1 if k else 1)]
        for array in arrays:
            digest.update(f"{array.shape}".encode())
            digest.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
        return digest.hexdigest()

    def cells(self) -> CellGrid:
        """Cells of the tile: all that a map of the whole region would have in its box."""
        box = None if self.tiling is None else self.tiling.box(self.index)
        return lay_cells(self.around, self.hyperparameters.spacing, self.hyperparameters.reach, box)

    def model(self) -> SplineModel:
        """Splines over the tile's cells."""
        return SplineModel(self.hyperparameters, order_elimination(self.cells()))

    def observe(self, model: SplineModel) -> SplineInformation:
        """Collect the information of the tile's samples."""
        total, *left_out = (model.observe(*self._inside(*part)) for part in self.parts)
        for information in left_out:
            total = total - information
        return total

    def infer(self) -> SplinePosterior:
        """Fit the tile."""
        model = self.model()
        return model.infer_in_single_precision(self.observe(model))

    def recall(self, weights: Scalars) -> SplinePosterior:
        """The posterior that has these weights, which an earlier fit gave; factorised only once that is needed.

        Raises `FitError` where they do not belong to the samples: at once where their number shows it, else on
        factorising.
        """
        cells = self.cells()
        if weights.shape != (cells.n_nodes + 3,):
            raise FitError(self.index, f"{len(weights)} weights are stored, {cells.n_nodes + 3} are needed")
        factors = Factors(partial(self._factorise_again, cells, weights))
        return SplinePosterior(self.hyperparameters, cells, factors, weights)

    def _factorise_again(self, cells: CellGrid, weights: Scalars, precision: type[np.floating]) -> CholeskyFactor:
        """Factor of the fit, once it is seen to give the field that was stored."""
        model = SplineModel(self.hyperparameters, order_elimination(cells))
        fit = model.infer if precision == np.float64 else model.infer_in_single_precision
        fitted = fit(self.observe(model))
        if not is_refit(fitted, weights, self.around):
            raise FitError(self.index, "fitting its samples again gives another field than was stored")
        return fitted.factors.light

    def _inside(self, points: Points, field: Vectors) -> Samples:
        """Samples in the tile's box; those beyond only shape its cells."""
        if self.tiling is None:
            return points, field
        rows = self.tiling.is_inside(points, self.index)
        return points[rows], field[rows]


@single_threaded
def fit_weights(task: TileTask) -> Scalars:
    """Posterior mean of a tile's weights: the same bits wherever it runs."""
    return task.infer().weights


@dataclass(frozen=True, eq=False, slots=True)
class TileTasks:
    """A survey cut into the tasks of its tiles, on demand: all at once would be several copies of the survey."""

    hyperparameters: Hyperparameters
    tiling: Tiling | None  # None: one tile holds the whole region
    tiles: list[Index]  # ascending
    around: Points  # points (m) that the cells are laid around, and which of them each tile sees
    around_rows: list[Indices]
    parts: tuple[Samples, ...]  # samples that inform the tiles less those of further parts, and which each tile sees
    rows: list[list[Indices]]

    def task(self, number: int) -> TileTask:
        """Task of one tile."""
        parts = [(p[rows[number]], b[rows[number]]) for (p, b), rows in zip(self.parts, self.rows, strict=True)]
        around = self.around[self.around_rows[number]]
        return TileTask(self.hyperparameters, self.tiling, self.tiles[number], around, parts)

    def fingerprint(self, index: Index) -> str:
        """Tell the inputs of a tile from all others; empty where there is no such tile."""
        place = bisect_left(self.tiles, index)
        return self.task(place).fingerprint() if index in self.tiles[place : place + 1] else ""
