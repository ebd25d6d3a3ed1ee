# SPDX-License-Identifier: BSD-3-Clause
"""Posterior samples of a field of many tiles that agree where tiles overlap.

A sample of ``N(P^-1 eta, P^-1)`` is ``P^-1 (eta + z)`` with ``z ~ N(0, P)``: the data and the prior, both disturbed
by noise of their own size, are fitted again. Every sample of the survey and every cell of the lattice has its own
noise, which all tiles share. So a draw varies from tile to tile no more than the mean does, each tile's draws have
exactly its posterior covariance, and the blend is as wide as its tiles.

Reference: Papandreou and Yuille 2010, Gaussian sampling by local perturbations (NeurIPS).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from magmatch.field.cholesky.cells import CellGrid
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_kernels import right_hand_sides
from magmatch.field.spline.spline_model import SplinePosterior
from magmatch.field.spline.spline_prior import CONSTANT_SD, cell_precision, cell_weights
from magmatch.field.tiles.tile_fit import TileTask
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Matrix, Scalars

# What noise belongs to.
SAMPLE, CELL, CONSTANT = 1, 2, 3
# Of a splitmix64 stream.
_STEP = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False, slots=True)
class TiledDraw:
    """One posterior sample: one row of every tile's draws."""

    draws_of: Callable[[int], Matrix]  # gives a tile's weights in every draw, (n_draws, m + 3)
    number: int

    def of_tile(self, number: int) -> Scalars:
        """Weights of one tile."""
        return np.asarray(self.draws_of(number)[self.number])


@single_threaded
def draw_tile(task: TileTask, seen: Indices, posterior: SplinePosterior, n_draws: int, seed: int) -> Matrix:
    """Posterior samples of a tile's weights, from noise that other tiles share; ``seen``: numbers of its samples."""
    h, seeds = task.hyperparameters, range(seed, seed + n_draws)
    deviation = posterior.factors.light.solve(_noise(task, seen, posterior.cells, seeds))
    return np.ascontiguousarray(posterior.weights + h.inflation * h.noise_sd * deviation.T)


def _noise(task: TileTask, seen: Indices, cells: CellGrid, seeds: range) -> np.ndarray:
    """Draws from N(0, P), P the posterior precision in units of the noise: (m + 3, n_draws)."""
    h, m = task.hyperparameters, cells.n_nodes
    ((points, _),) = task.parts  # samples left out would leave no noise to share
    z = np.zeros((m + 3, len(seeds)))
    root, spread = _root(h), np.sqrt(cell_weights(cells.distance))[:, None]
    names, constant = _names(CELL, cells.cells + cells.first), _names(CONSTANT, np.zeros((1, 1), dtype=np.int64))
    for k, seed in enumerate(seeds):
        drawn = (normals(seed, names, 64) @ root) * spread
        z[:m, k] = np.bincount(cells.cell_nodes.ravel(), drawn.ravel(), m)
        z[m:, k] += h.noise_sd / CONSTANT_SD * normals(seed, constant, 3)[0]
    inside = slice(None) if task.tiling is None else task.tiling.is_inside(points, task.index)
    names = _names(SAMPLE, seen[inside, None])
    # Phi^T e with white e has covariance Phi^T Phi, as the samples' information does.
    white = np.stack([normals(seed, names, 3) for seed in seeds], axis=2)
    return np.asarray(z + right_hand_sides(cells, points[inside], white))


@lru_cache(maxsize=8)
def _root(h: Hyperparameters) -> np.ndarray:
    """R with ``R^T R`` the prior precision of a cell: (64, 64)."""
    values, vectors = np.linalg.eigh(cell_precision(h))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


def _names(kind: int, labels: np.ndarray) -> np.ndarray:
    """One 64-bit name per row of integers (n, k)."""
    names = np.full(len(labels), kind, dtype=np.uint64)
    for column in labels.T:
        names = _mixed(names ^ np.ascontiguousarray(column).astype(np.int64).view(np.uint64))
    return names


def _mixed(x: np.ndarray) -> np.ndarray:
    """Scramble the bits of 64-bit numbers (splitmix64 by Steele, Lea and Flood 2014)."""
    x = x + _STEP
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


def normals(seed: int, names: np.ndarray, count: int) -> np.ndarray:
    """Standard normal numbers that depend on seed and name alone, (n, count): by Box and Muller's transform."""
    start = _mixed(names ^ _mixed(np.full(1, seed % 2**64, dtype=np.uint64)))
    bits = _mixed(start[:, None] + _STEP * np.arange(count + count % 2, dtype=np.uint64))
    u = ((bits >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53
    radius, angle = np.sqrt(-2 * np.log(u[:, 0::2])), 2 * np.pi * u[:, 1::2]
    both = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=2)
    return np.asarray(both.reshape(len(names), -1)[:, :count])
