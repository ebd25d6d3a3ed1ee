# SPDX-License-Identifier: BSD-3-Clause
"""The checkpoint of a live estimate: samples and sums, from which every block is fitted again to the same bits."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.data.checks import MAX_EXTENT, MAX_FIELD
from magmatch.field.config import EstimatorConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.live.live_cells import COUNT, KEPT_PER_CELL, N_SUMS
from magmatch.field.live.live_tiles import LiveTiles
from magmatch.store import expect, load, naming, save

SCHEMA = "magmatch.live/2"
# Where the sums of the field (1 row) and of its products (3 rows) stand in 'moments'.
N_MOMENTS = 4
# Lattice indices beyond this are not told apart by float64 coordinates.
MAX_LATTICE = 2**52


@dataclass(frozen=True, eq=False, slots=True)
class LiveRecord:
    """Content of a checkpoint."""

    config: EstimatorConfig
    hyperparameters: Hyperparameters | None  # None before they were chosen; nothing but ``first`` is there then
    n_chosen: int  # from how many samples they were chosen last, while they are not settled
    n_samples: int  # how many samples the blocks have taken in
    # ``start`` (1, 3): position of the first sample, m. ``first`` (n, 6): samples from before the hyperparameters
    # were settled, m and T; missing once they are. ``kept`` (n, 6): samples that are kept as they are, block by
    # block. ``summed_cells`` (k, 3) and ``sums`` (k, 2341): cells that hold more, and sums over the other samples.
    # ``moments`` (4, 3): sum of all fields and of their products, T and T^2.
    arrays: Mapping[str, np.ndarray]

    @property
    def start(self) -> np.ndarray | None:
        """Position of the first sample."""
        return self.arrays["start"][0] if "start" in self.arrays else None

    @classmethod
    def of(
        cls, config: EstimatorConfig, n_chosen: int, start: np.ndarray | None, first: np.ndarray | None,
        tiles: LiveTiles | None,
    ) -> "LiveRecord":  # fmt: skip
        """Take down an estimate."""
        arrays: dict[str, np.ndarray] = {}
        if start is not None:
            arrays["start"] = start[None]
        if first is not None:
            arrays["first"] = first
        if tiles is None or not tiles.blocks:
            return cls(config, None if tiles is None else tiles.hyperparameters, n_chosen, 0, arrays)
        blocks = tiles.blocks.values()
        arrays["kept"] = tiles.kept
        arrays["summed_cells"] = np.concatenate([b.summed_cells for b in blocks]).astype(np.float64)
        arrays["sums"] = np.concatenate([b.sums for b in blocks])
        arrays["moments"] = np.vstack([tiles.total, tiles.squares])
        return cls(config, tiles.hyperparameters, n_chosen, tiles.n_samples, arrays)

    def restore_into(self, tiles: LiveTiles) -> LiveTiles:
        """Fill empty tiles with what was measured."""
        if "kept" in self.arrays:
            moments = self.arrays["moments"]
            tiles.absorb(self.arrays["kept"])
            tiles.restore(self.arrays["summed_cells"].astype(np.int64), self.arrays["sums"])
            tiles.n_samples, tiles.total, tiles.squares = self.n_samples, moments[0].copy(), moments[1:].copy()
        return tiles

    def write(self, path: str | Path) -> None:
        """Save the record, whole or not at all; see `read`."""
        content = {
            "config": self.config.model_dump(mode="json"),
            "hyperparameters": self.hyperparameters,
            "n_chosen": self.n_chosen,
            "n_samples": self.n_samples,
            "arrays": self.arrays,
        }
        save(path, SCHEMA, content)

    @classmethod
    def read(cls, path: str | Path) -> "LiveRecord":
        """Read and check a checkpoint."""
        content = load(path, SCHEMA, (Hyperparameters,))
        with naming(path):
            expect(content, hyperparameters=(Hyperparameters, type(None)), n_chosen=int, n_samples=int, arrays=dict)
            content["config"] = EstimatorConfig.model_validate(content["config"])
            record = cls(**content)
            record.check()
        return record

    def check(self) -> None:
        """Refuse content that no estimate has."""
        for name, array in self.arrays.items():
            n_columns = {"start": 3, "first": 6, "kept": 6, "summed_cells": 3, "sums": N_SUMS, "moments": 3}[name]
            if array.dtype != np.float64 or array.shape[1:] != (n_columns,) or not np.isfinite(array).all():
                msg = f"entry '{name}': expected finite numbers, (n, {n_columns}), got {array.shape}"
                raise ValueError(msg)
        h = self.hyperparameters
        if h is not None:
            h.check()
        if min(self.n_chosen, self.n_samples) < 0:
            msg = f"expected counts, got n_chosen {self.n_chosen} and n_samples {self.n_samples}"
            raise ValueError(msg)
        self._check_samples()
        if "kept" not in self.arrays:
            return
        sums, cells, moments = (self.arrays[name] for name in ("sums", "summed_cells", "moments"))
        counts = sums[:, COUNT]
        n_samples = len(self.arrays["kept"]) + counts.sum()
        if h is None or "start" not in self.arrays or len(moments) != N_MOMENTS or self.n_samples != n_samples:
            msg = f"expected {self.n_samples} samples with their hyperparameters and moments, got {n_samples:.0f}"
            raise ValueError(msg)
        is_whole = np.array_equal(cells, np.round(cells)) and np.array_equal(counts, np.round(counts))
        if len(cells) != len(sums) or not is_whole or (counts < 1).any():
            msg = "entry 'sums': expected a cell of the lattice and a count for each row"
            raise ValueError(msg)
        lattice = np.floor(self.arrays["kept"][:, :3] / h.spacing + 0.5)
        found, n_kept = np.unique(lattice, axis=0, return_counts=True)
        full = {tuple(cell) for cell in found[n_kept == KEPT_PER_CELL].tolist()}
        if (n_kept > KEPT_PER_CELL).any() or {tuple(cell) for cell in cells.tolist()} - full:
            msg = f"entry 'sums': expected sums over cells that keep {KEPT_PER_CELL} samples"
            raise ValueError(msg)

    def _check_samples(self) -> None:
        """Refuse samples that `FieldEstimator.update` would have refused."""
        samples = [self.arrays[name] for name in ("first", "kept") if name in self.arrays and len(self.arrays[name])]
        if samples and self.start is None:
            msg = "entry 'start' is missing"
            raise ValueError(msg)
        start = np.zeros(3) if self.start is None else self.start
        for rows in samples:
            if np.abs(rows[:, :3] - start).max() > MAX_EXTENT or np.abs(rows[:, 3:]).max() > MAX_FIELD:
                msg = f"expected samples within {MAX_EXTENT / 1e3:.0f} km of 'start' and below {MAX_FIELD} T"
                raise ValueError(msg)
        spacing = 1.0 if self.hyperparameters is None else self.hyperparameters.spacing
        if (np.abs(start).max() + MAX_EXTENT) / spacing > MAX_LATTICE:
            msg = f"entry 'start': {start} m is too far away for cells of {spacing:.3g} m"
            raise ValueError(msg)
