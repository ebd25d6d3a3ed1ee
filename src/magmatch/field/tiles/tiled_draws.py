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

from magmatch.compiled import compiled
from magmatch.field.cholesky.cells import CellGrid
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_basis import FIRST
from magmatch.field.spline.spline_kernels import add_right_hand_sides
from magmatch.field.spline.spline_model import SplinePosterior
from magmatch.field.spline.spline_prior import CONSTANT_SD, cell_precision, cell_weights
from magmatch.field.tiles.tile_fit import TileTask, TileTasks
from magmatch.threads import single_threaded
from magmatch.typing import Indices, Matrix, Scalars

# What noise belongs to.
SAMPLE, CELL, CONSTANT = 1, 2, 3


@dataclass(frozen=True, eq=False, slots=True)
class TiledDraw:
    """One posterior sample: one row of every tile's draws."""

    draws: "TiledDraws"
    number: int

    def of_tile(self, number: int) -> Scalars:
        """Weights of one tile."""
        return np.asarray(self.draws.of_tile(number)[self.number])


class TiledDraws:
    """Draws of a posterior, computed tile by tile as points fall into them."""

    def __init__(self, tasks: TileTasks, factored: Callable[[int], SplinePosterior], n_draws: int, seed: int) -> None:
        self.tasks, self.factored, self.n_draws, self.seed = tasks, factored, n_draws, seed
        self._found: dict[int, Matrix] = {}

    def of_tile(self, number: int) -> Matrix:
        """Weights of a tile in every draw: (n_draws, m + 3)."""
        if number not in self._found:
            task, seen = self.tasks.task(number), self.tasks.rows[0][number]
            self._found[number] = draw_tile(task, seen, self.factored(number), self.n_draws, self.seed)
        return self._found[number]


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
        scatter_add((normals(seed, names, 64) @ root) * spread, cells.cell_nodes, z[:, k])
        z[m:, k] += h.noise_sd / CONSTANT_SD * normals(seed, constant, 3)[0]
    inside = slice(None) if task.tiling is None else task.tiling.is_inside(points, task.index)
    names, (cell, t) = _names(SAMPLE, seen[inside, None]), cells.locate(points[inside])
    # Phi^T e with white e has covariance Phi^T Phi, as the samples' information does.
    white = np.stack([normals(seed, names, 3) for seed in seeds], axis=2)
    add_right_hand_sides(cell, t, white, cells.cell_nodes, FIRST, z[:m])
    z[m:] += white.sum(axis=0)
    return z


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
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


def normals(seed: int, names: np.ndarray, count: int) -> np.ndarray:
    """Standard normal numbers that depend on seed and name alone: (n, count)."""
    start = _mixed(names ^ _mixed(np.full(1, seed % 2**64, dtype=np.uint64)))
    out = np.empty((len(names), count))
    fill_normals(start, out)
    return out


@compiled
def fill_normals(start: np.ndarray, out: np.ndarray) -> None:
    """Fill each row by Box and Muller's transform of a splitmix64 stream from its start."""
    for i in range(out.shape[0]):
        state = start[i]
        for j in range(0, out.shape[1], 2):
            u = np.empty(2)
            for k in range(2):
                state += np.uint64(0x9E3779B97F4A7C15)
                x = state
                x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                x = x ^ (x >> np.uint64(31))
                u[k] = (np.float64(x >> np.uint64(11)) + 0.5) / 9007199254740992.0
            radius = np.sqrt(-2.0 * np.log(u[0]))
            out[i, j] = radius * np.cos(2 * np.pi * u[1])
            if j + 1 < out.shape[1]:
                out[i, j + 1] = radius * np.sin(2 * np.pi * u[1])


@compiled
def scatter_add(values: np.ndarray, cell_nodes: np.ndarray, out: np.ndarray) -> None:
    """Add one value per cell and node of it to the nodes."""
    for n in range(cell_nodes.shape[0]):
        for a in range(cell_nodes.shape[1]):
            out[cell_nodes[n, a]] += values[n, a]
