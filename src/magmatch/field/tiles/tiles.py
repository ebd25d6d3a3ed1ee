# SPDX-License-Identifier: BSD-3-Clause
"""The division of space into tiles: cubes of cells on one lattice, the samples of each, and their blending.

A tile is responsible for its *core*, a cube of cells. It is fitted to all samples in the core and a *margin* around
it, and near the faces of the core its values fade into its neighbours' over the *blend*. The lattice is fixed to the
origin of the model's frame, so tiles do not move when samples are added, and all tiles share one grid of splines.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import lattice_coordinate
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index
from magmatch.grid import distinct_cells
from magmatch.typing import Indices, Points, Scalars

# Side of a core, cells: the cost per core is least at about four margins, and a factor stays below 0.2 GB.
CORE = 24
# Half the width over which two tiles blend, cells.
BLEND = 2
# Cells between core and cut. Closer cuts cost less; with these, tiles differ from one large fit by a quarter of a
# posterior standard deviation (rms) and predict new points as well (benchmarks/bench_tiles.py agreement).
LEAST_MARGIN, FIXED_MARGIN, MARGIN_IN_LENGTHSCALES, MOST_MARGIN = 5, 3.0, 0.5, 9
# So that tiles can be counted in 64 bits, and listed in a file.
MOST_CELLS_ALONG, MOST_TILES = 40_000_000, 40_000


@dataclass(frozen=True, slots=True)
class Tiling:
    """Sizes of tiles on a lattice of cells."""

    spacing: float  # m: side of a cell
    margin: int  # cells: how far a tile's samples reach beyond its core
    reach: int  # cells: how far a sample activates cells around its own
    core: int = CORE  # cells: side of a core
    blend: int = BLEND  # cells: half the width over which tiles blend

    @classmethod
    def suited_to(cls, h: Hyperparameters) -> "Tiling":
        """Sizes for a field of such numbers."""
        wished = round(FIXED_MARGIN + MARGIN_IN_LENGTHSCALES * min(h.lengthscale / h.spacing, MOST_MARGIN * 2))
        return cls(h.spacing, int(np.clip(wished, LEAST_MARGIN, MOST_MARGIN)), int(np.floor(h.reach)))

    def first_cell(self, index: Index) -> np.ndarray:
        """First cell of a tile's core."""
        return np.asarray(np.array(index) * self.core - self.core // 2)

    def box(self, index: Index) -> tuple[np.ndarray, np.ndarray]:
        """First and one past the last cell of a tile, margin included."""
        low = self.first_cell(index) - self.margin
        return low, low + self.core + 2 * self.margin

    def occupied(self, points: Points) -> list[Index]:
        """Tiles whose answer (blend included) samples at points inform, in order."""
        cells = distinct_cells(self._cells(points))
        if np.ptp(cells, axis=0).max() > MOST_CELLS_ALONG:
            extent = np.ptp(points, axis=0).max()
            msg = f"the region ({extent:.3g} m) is too large for a spacing of {self.spacing:.3g} m; widen the spacing"
            raise ConfigurationError(msg)
        around = self._tiles_around(cells, self.blend + self.reach)
        found = distinct_cells(np.concatenate([tile for _, tile in around]))
        if len(found) > MOST_TILES:
            msg = (
                f"the region is too large for a spacing of {self.spacing:.3g} m: it takes {len(found):,} tiles, at "
                f"most {MOST_TILES:,}; widen the spacing or map it in parts"
            )
            raise ConfigurationError(msg)
        return [(int(i), int(j), int(k)) for i, j, k in found]

    def assign(self, points: Points, tiles: list[Index]) -> list[Indices]:
        """Rows of the points that each tile sees: those in its box, and those beyond whose cells reach into it."""
        row, owner = TileKeys(tiles).owned(self._tiles_around(self._cells(points), self.margin + self.reach))
        return np.split(row, np.searchsorted(owner, np.arange(1, len(tiles))))

    def is_inside(self, points: Points, index: Index) -> np.ndarray:
        """Whether points lie in the box of a tile."""
        low, high = self.box(index)
        cells = self._cells(points)
        return np.asarray(np.all((cells >= low) & (cells < high), axis=1))

    def blended(self, points: Points, keys: "TileKeys") -> Iterator[tuple[int, Indices]]:
        """For each tile with a say somewhere: its number and the rows of those points."""
        v = self._coordinate(points)
        # Beyond the outermost tiles nothing is found; clipping keeps faraway points within integers.
        v = np.clip(np.nan_to_num(v, nan=-1e15), (keys.low - 2) * self.core, (keys.high + 2) * self.core)
        first = np.floor((v - self.blend) / self.core).astype(np.int64)
        last = np.floor((v + self.blend) / self.core).astype(np.int64)
        row, owner = keys.owned(_between(first, last))
        start = np.flatnonzero(np.diff(owner, prepend=-1))
        for low, high in pairwise([*start, len(row)]):
            yield int(owner[low]), row[low:high]

    def axis_weights(self, x: Scalars, number: int) -> list[Scalars]:
        """A tile's share along one axis, and its first and second derivatives (1/m, 1/m^2): C2, summing to 1."""
        v = self._coordinate(x) - number * self.core
        rise = smooth_step((v + self.blend) / (2 * self.blend))
        fall = smooth_step((v - self.core + self.blend) / (2 * self.blend))
        scale = 1.0 / (2 * self.blend * self.spacing)
        return [(r - f) * scale**k for k, (r, f) in enumerate(zip(rise, fall, strict=True))]

    def _coordinate(self, points: Points) -> np.ndarray:
        """Position in cells, counted from the first cell of tile 0."""
        return lattice_coordinate(np.asarray(points), self.spacing) + self.core // 2

    def _cells(self, points: Points) -> np.ndarray:
        return np.asarray(np.floor(lattice_coordinate(points, self.spacing)).astype(np.int64))

    def _tiles_around(self, cells: np.ndarray, distance: int) -> Iterator[tuple[Indices, np.ndarray]]:
        """Pairs of rows and tiles whose core lies within a distance (in cells) of these cells."""
        v = cells + self.core // 2
        yield from _between(np.floor_divide(v - distance, self.core), np.floor_divide(v + distance, self.core))


class TileKeys:
    """Finds the number of a tile from its index."""

    def __init__(self, tiles: list[Index]) -> None:
        table = np.array(tiles, dtype=np.int64).reshape(-1, 3)
        self.low, self.high = table.min(axis=0), table.max(axis=0)
        self._keys = self._key(table)

    def find(self, index: np.ndarray) -> np.ndarray:
        """Number of each tile (n, 3); -1 where there is none."""
        is_near = np.all((index >= self.low) & (index <= self.high), axis=1)
        key = self._key(np.where(is_near[:, None], index, self.low))
        place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return np.where(is_near & (self._keys[place] == key), place, -1)

    def owned(self, pairs: Iterator[tuple[Indices, np.ndarray]]) -> tuple[Indices, Indices]:
        """Rows and the numbers of their tiles, tile by tile, of pairs of rows and tiles (n, 3)."""
        found = [(row[owner >= 0], owner[owner >= 0]) for row, tile in pairs for owner in (self.find(tile),)]
        row, owner = (np.concatenate(part) for part in zip(*found, strict=True))
        order = np.lexsort((row, owner))
        return row[order], owner[order]

    def _key(self, index: np.ndarray) -> np.ndarray:
        """One number per tile, in the order of their indices."""
        _, ny, nz = self.high - self.low + 1
        x, y, z = (index - self.low).T
        return np.asarray((x * ny + y) * nz + z)


def _between(first: np.ndarray, last: np.ndarray) -> Iterator[tuple[Indices, np.ndarray]]:
    """Every index from first to last (n, 3), with the row it belongs to."""
    most = (last - first).max(axis=0, initial=0)
    for step in product(*(range(int(n) + 1) for n in most)):
        index = first + np.array(step)
        row = np.flatnonzero(np.all(index <= last, axis=1))
        yield row, index[row]


def smooth_step(t: np.ndarray) -> list[np.ndarray]:
    """Rise from 0 (t <= 0) to 1 (t >= 1) with two continuous derivatives: value, first, second derivative."""
    s = np.clip(t, 0.0, 1.0)
    r = 1.0 - s
    return [s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * r**2, 60 * s * r * (1 - 2 * s)]
