# SPDX-License-Identifier: BSD-3-Clause
"""Tiles of a live field estimate: blocks of cells collect samples, tiles are fitted on demand.

Blocks are the cores of the tiles and do not overlap, so memory depends on the area visited only.
A tile is fitted to its own block and those around it when a prediction touches it and they have changed.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from magmatch.field.cholesky.cells import lattice_coordinate, lay_cells
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index
from magmatch.field.live.live_cells import COUNT, Block, MeasuredCells, add_sums
from magmatch.field.spline.spline_model import SplineModel, SplinePosterior
from magmatch.field.spline.spline_prior import outside_covariance
from magmatch.field.tiles.blending import blended_covariance, blended_values, tile_shares
from magmatch.field.tiles.tiles import TileKeys, Tiling
from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Points, Vector3, Vectors

# Memory of fitted tiles that are kept (5 to 40 MB each), and how many are kept whatever they take: as many as have a
# say at one point.
FITTED_BYTES, LEAST_FITTED = 512 * 2**20, 8


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """The mean and variance of the field at n points, map frame."""

    values: FieldValues  # posterior mean of field and derivatives
    covariance: np.ndarray  # (n, 3, 3), T^2: of the noise-free field; where blocks blend, an upper bound
    is_known: Mask  # (n,): where there are samples near

    @property
    def field(self) -> Vectors:
        """Mean of the field, T."""
        return self.values.field

    @property
    def variance(self) -> Vectors:
        """Variance of each component, T^2: (n, 3)."""
        return np.asarray(np.diagonal(self.covariance, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False, slots=True)
class FittedTile:
    """A tile as it was fitted: to which versions of its blocks, and when (s)."""

    posterior: SplinePosterior
    versions: tuple[int, ...]
    time: float


class LiveTiles:
    """Blocks of samples and the tiles over them, with fixed hyperparameters."""

    def __init__(self, hyperparameters: Hyperparameters, tiling: Tiling, clock: Callable[[], float]) -> None:
        self.hyperparameters, self.tiling, self.clock = hyperparameters, tiling, clock
        self.blocks: dict[Index, Block] = {}
        self.n_samples, self.total, self.squares = 0, np.zeros(3), np.zeros((3, 3))
        self.n_fits = 0
        self._tiles: set[Index] = set()
        self._keys: tuple[list[Index], TileKeys] | None = None
        self._fits: OrderedDict[Index, FittedTile] = OrderedDict()

    @property
    def kept(self) -> np.ndarray:
        """Position (m) and field (T) of all samples that are kept as they are: (n, 6)."""
        return np.concatenate([block.kept for block in self.blocks.values()])

    @property
    def n_bytes(self) -> int:
        """Memory of what has been measured (fitted tiles aside)."""
        return sum(block.n_bytes for block in self.blocks.values())

    def absorb(self, samples: np.ndarray) -> None:
        """Take in samples, (n, 6): position (m) and field (T)."""
        coordinate = lattice_coordinate(samples[:, :3], self.tiling.spacing)
        cell = np.floor(coordinate).astype(np.int64)
        for index, rows in self._by_block(cell).items():
            block = self._block(index)
            is_new = block.absorb(cell[rows], coordinate[rows] - cell[rows], samples[rows])
            if is_new.any():
                self._add_tiles(samples[rows[is_new], :3])
        self.n_samples += len(samples)
        self.total += samples[:, 3:].sum(axis=0)
        self.squares += samples[:, 3:].T @ samples[:, 3:]

    def measured(self) -> MeasuredCells:
        """All that was measured, from which every block is fitted again to the same bits."""
        cells = np.concatenate([block.summed_cells for block in self.blocks.values()])
        sums = np.concatenate([block.sums for block in self.blocks.values()])
        return MeasuredCells(self.kept, cells, sums, self.total, self.squares)

    def restore(self, measured: MeasuredCells) -> None:
        """Fill empty tiles with what was measured."""
        self.absorb(measured.kept)
        for index, rows in self._by_block(measured.cells).items():
            self.blocks[index].restore(measured.cells[rows], measured.sums[rows])
        self.n_samples += int(measured.sums[:, COUNT].sum())
        self.total, self.squares = measured.total.copy(), measured.squares.copy()

    def change(self, hyperparameters: Hyperparameters) -> None:
        """Go on with other numbers for the same cells."""
        self.hyperparameters = hyperparameters
        self._fits.clear()

    def predict(self, points: Points, order: int, max_age: float, *, with_variance: bool) -> Prediction:
        """Field and derivatives at points, with the covariance of the field where it is asked for (else NaN)."""
        tiles, keys = self._tile_keys()
        shares = list(tile_shares(self.tiling, tiles, keys, points, order))
        fits = {number: self._fitted(tiles[number], max_age) for number, _, _ in shares}
        mean, spread = self._far_away()
        values = blended_values(points, order, mean, shares, lambda k, p: fits[k].evaluate(p, order))
        covariance = np.full((len(points), 3, 3), np.nan)
        if with_variance:
            outside = outside_covariance(self.hyperparameters, spread)[:3, :3]
            covariance = blended_covariance(points, 0, outside, shares, fits.__getitem__)
        known = np.zeros(len(points), dtype=np.bool_)
        for number, rows, _ in shares:
            known[rows] |= fits[number].knows(points[rows])
        return Prediction(values, covariance, known)

    def fit(self, index: Index) -> SplinePosterior:
        """Fit a tile to all that has been measured in it and around it."""
        blocks = [self.blocks[i] for i in self._around(index)]
        kept = np.concatenate([block.kept for block in blocks])
        cells = lay_cells(kept[:, :3], self.tiling.spacing, self.hyperparameters.reach, self.tiling.box(index))
        model = SplineModel(self.hyperparameters, order_elimination(cells))
        inside = kept[self.tiling.is_inside(kept[:, :3], index)]
        information = model.observe(inside[:, :3], inside[:, 3:])
        for block in blocks:
            information = add_sums(information, cells, block)
        return model.infer(information)

    def _fitted(self, index: Index, max_age: float) -> SplinePosterior:
        """Posterior of a tile that holds all data older than ``max_age``, s."""
        versions = tuple(self.blocks[i].version for i in self._around(index))
        fit, now = self._fits.get(index), self.clock()
        if fit is None or (fit.versions != versions and now - fit.time >= max_age):
            fit = FittedTile(self.fit(index), versions, now)
            self.n_fits += 1
            self._fits[index] = fit
            self._fits.move_to_end(index)
            self._forget()
        self._fits.move_to_end(index)
        return fit.posterior

    def _forget(self) -> None:
        """Drop fitted tiles that were asked for longest ago, as far as memory demands."""
        n_bytes = [fit.posterior.factors.n_bytes for fit in self._fits.values()]
        while len(n_bytes) > LEAST_FITTED and sum(n_bytes) > FITTED_BYTES:
            self._fits.popitem(last=False)
            n_bytes.pop(0)

    def _around(self, index: Index) -> list[Index]:
        """Blocks that a tile sees, itself included."""
        n = -(-(self.tiling.margin + self.tiling.reach) // self.tiling.core)
        i, j, k = index
        steps = product(range(-n, n + 1), repeat=3)
        return [at for a, b, c in steps if (at := (i + a, j + b, k + c)) in self.blocks]

    def _by_block(self, cells: np.ndarray) -> dict[Index, np.ndarray]:
        """Rows of cells (n, 3) that each block holds, in order."""
        core = self.tiling.core
        rows: dict[Index, list[int]] = {}
        for row, (i, j, k) in enumerate(np.floor_divide(cells + core // 2, core).tolist()):
            rows.setdefault((i, j, k), []).append(row)
        return {index: np.array(chosen) for index, chosen in rows.items()}

    def _block(self, index: Index) -> Block:
        if index not in self.blocks:
            self.blocks[index] = Block(self.tiling.first_cell(index), self.tiling.core)
        return self.blocks[index]

    def _add_tiles(self, points: Points) -> None:
        """Let there be tiles wherever samples in these places say something."""
        found = self.tiling.occupied(points)
        if not self._tiles.issuperset(found):
            self._tiles.update(found)
            self._keys = None

    def _tile_keys(self) -> tuple[list[Index], TileKeys]:
        if self._keys is None:
            tiles = sorted(self._tiles)
            self._keys = tiles, TileKeys(tiles)
        return self._keys

    def _far_away(self) -> tuple[Vector3, np.ndarray]:
        """Mean of the measured fields and their covariance: what is said where nothing was measured."""
        mean = self.total / self.n_samples
        return mean, self.squares / self.n_samples - np.outer(mean, mean)
