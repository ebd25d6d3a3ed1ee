# SPDX-License-Identifier: BSD-3-Clause
"""A survey cut into the tasks of its tiles, on demand: all at once would be several copies of the survey."""

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import Index
from magmatch.field.tiles.tile_fit import Samples, TileTask
from magmatch.field.tiles.tiles import Tiling
from magmatch.typing import Indices, Points


@dataclass(frozen=True, eq=False, slots=True)
class TileTasks:
    """What the fit of every tile depends on."""

    hyperparameters: Hyperparameters
    tiling: Tiling | None  # None: one tile holds the whole region
    tiles: list[Index]
    around: Points  # points (m) that the cells are laid around, and which of them each tile sees
    around_rows: list[Indices]
    parts: tuple[Samples, ...]  # samples that inform the tiles, and of each part which samples each tile sees
    rows: list[list[Indices]]

    def task(self, number: int) -> TileTask:
        """Task of one tile."""
        parts = [
            Samples(p.points[rows[number]], p.field[rows[number]], p.weights[rows[number]], p.sign)
            for p, rows in zip(self.parts, self.rows, strict=True)
        ]
        around = self.around[self.around_rows[number]]
        return TileTask(self.hyperparameters, self.tiling, self.tiles[number], around, parts)

    def fingerprint(self, index: Index) -> str:
        """What tells the inputs of a tile from all others; empty where there is no such tile."""
        place = bisect_left(self.tiles, index)
        return self.task(place).fingerprint() if index in self.tiles[place : place + 1] else ""

    def sample_numbers(self, number: int) -> list[Indices]:
        """Which samples, counted over all parts, a tile sees: one array per part."""
        starts = np.cumsum([0, *(len(p.points) for p in self.parts[:-1])])
        return [start + rows[number] for start, rows in zip(starts, self.rows, strict=True)]
