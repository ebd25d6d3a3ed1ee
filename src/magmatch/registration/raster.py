# SPDX-License-Identifier: BSD-3-Clause
"""A map's field and its spread on a grid, for the many cheap look-ups of a search (trilinear)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view

from magmatch.field.map import FieldMap
from magmatch.grid import RegularGrid
from magmatch.typing import Mask, Points, Scalars, Tensors, Vectors

MAX_POINTS = 1_500_000
# Least share of the map's own samples that its raster must know.
MIN_COVERED = 0.95
# Of the raster's cells that touch what the map knows, the share whose corners are all known: around a line most are
# not, and half of what the map knows would be lost. Rasters are made finer for that up to so many known points.
MIN_WHOLE, FEW_POINTS = 0.7, 20_000


@dataclass(frozen=True, eq=False, slots=True)
class Raster:
    """Field and standard deviation at the points of a grid, in the map's model frame.

    Attributes
    ----------
    origin : (3,) array, m, model frame
    spacing : float, m
    field : (nx, ny, nz, 3) array, T
    sd : (nx, ny, nz) array, T
        Standard deviation of one component; negative where the map does not know the field.
    """

    origin: np.ndarray
    spacing: float
    field: np.ndarray
    sd: np.ndarray

    @property
    def volume(self) -> float:
        """Volume of the region that the map knows, m^3."""
        return float((self.sd >= 0).sum() * self.spacing**3)

    @property
    def whole_share(self) -> float:
        """Of the cells with a known corner, the share that can be looked up."""
        corners = sliding_window_view(self.sd >= 0, (2, 2, 2)).sum(axis=(3, 4, 5))
        return float((corners == 8).sum() / max((corners > 0).sum(), 1))

    def lookup(self, points: Points) -> tuple[Vectors, Scalars, Tensors, Mask]:
        """Field, spread and gradient at points, by trilinear interpolation.

        Parameters
        ----------
        points : (n, 3) array, m, model frame

        Returns
        -------
        field : (n, 3) array, T
        sd : (n,) array, T
        gradient : (n, 3, 3) array, T/m
        is_known : (n,) bool array
            False outside the map; the other values are 0 there.
        """
        out = np.zeros((len(points), 13))
        is_known = np.zeros(len(points), dtype=np.bool_)
        _lookup_many(self.field, self.sd, self.origin, self.spacing, points, out, is_known)
        return out[:, :3], out[:, 3], out[:, 4:].reshape(-1, 3, 3), is_known


def rasterize(field_map: FieldMap, spacing: float, draws: Sequence[Any]) -> Raster:
    """Evaluate a map on a grid laid along its own model axes.

    Parameters
    ----------
    field_map : FieldMap
        Map to look up.
    spacing : float, m
        Distance of grid points; widened where the region would need more than `MAX_POINTS`, narrowed where the
        map knows only a thin layer.
    draws : sequence of weights
        Posterior samples that give the spread (see ``posterior.draw_weights``).

    Returns
    -------
    Raster
    """
    samples = field_map.survey.transformed(field_map.T_map_model.inv()).positions
    while True:
        raster = _rasterize(field_map, samples, spacing, draws)
        *_, is_known = raster.lookup(samples)
        # A thin layer of known field may fall between the points of a coarse grid, a line lose its surroundings.
        is_lost = is_known.mean() < MIN_COVERED and raster.sd.size < MAX_POINTS / 8
        is_ragged = raster.whole_share < MIN_WHOLE and 8 * (raster.sd >= 0).sum() < FEW_POINTS
        if raster.spacing > spacing or not (is_lost or is_ragged):
            return raster
        spacing /= 2


def _rasterize(field_map: FieldMap, samples: Points, spacing: float, draws: Sequence[Any]) -> Raster:
    posterior = field_map.posterior
    margin = 2 * spacing
    extent = np.ptp(samples, axis=0) + 2 * margin
    spacing = max(spacing, float(np.cbrt(np.prod(np.maximum(extent, spacing)) / MAX_POINTS)))
    grid = RegularGrid.over(samples, spacing, margin)
    points = grid.points()
    rows = np.flatnonzero(posterior.knows(points))
    mean = posterior.evaluate(points[rows]).field
    power = np.zeros(len(rows))
    for weights in draws:
        power += ((posterior.evaluate(points[rows], 0, weights).field - mean) ** 2).mean(axis=1)
    field = np.zeros((grid.n_points, 3))
    sd = np.full(grid.n_points, -1.0)
    field[rows], sd[rows] = mean, np.sqrt(power / len(draws))
    return Raster(grid.T_map_grid.translation, spacing, field.reshape(*grid.shape, 3), sd.reshape(grid.shape))


@njit(cache=True)
def interpolate(field, sd, origin, spacing, p, out):  # type: ignore[no-untyped-def]
    """Trilinear field (out[:3]), sd (out[3]) and gradient (out[4:13], row-major dB_a/dx_b); False where unknown."""
    nx, ny, nz = sd.shape
    u, v, w = (p[0] - origin[0]) / spacing, (p[1] - origin[1]) / spacing, (p[2] - origin[2]) / spacing
    i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
    if i < 0 or j < 0 or k < 0 or i >= nx - 1 or j >= ny - 1 or k >= nz - 1:
        return False
    u, v, w = u - i, v - j, w - k
    out[:] = 0.0
    for a in range(2):
        wx, dx = (u, 1.0) if a else (1 - u, -1.0)
        for b in range(2):
            wy, dy = (v, 1.0) if b else (1 - v, -1.0)
            for c in range(2):
                wz, dz = (w, 1.0) if c else (1 - w, -1.0)
                s = sd[i + a, j + b, k + c]
                if s < 0:
                    return False
                out[3] += wx * wy * wz * s
                for d in range(3):
                    f = field[i + a, j + b, k + c, d]
                    out[d] += wx * wy * wz * f
                    out[4 + 3 * d] += dx * wy * wz * f / spacing
                    out[5 + 3 * d] += wx * dy * wz * f / spacing
                    out[6 + 3 * d] += wx * wy * dz * f / spacing
    return True


@njit(cache=True)
def interpolate_field(field, sd, origin, spacing, p, out):  # type: ignore[no-untyped-def]
    """Trilinear field (out[:3]) and sd (out[3]) only; False where unknown."""
    nx, ny, nz = sd.shape
    u, v, w = (p[0] - origin[0]) / spacing, (p[1] - origin[1]) / spacing, (p[2] - origin[2]) / spacing
    i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
    if i < 0 or j < 0 or k < 0 or i >= nx - 1 or j >= ny - 1 or k >= nz - 1:
        return False
    u, v, w = u - i, v - j, w - k
    out[0], out[1], out[2], out[3] = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        wx = u if a else 1 - u
        for b in range(2):
            wxy = wx * (v if b else 1 - v)
            for c in range(2):
                weight = wxy * (w if c else 1 - w)
                s = sd[i + a, j + b, k + c]
                if s < 0:
                    return False
                out[3] += weight * s
                for d in range(3):
                    out[d] += weight * field[i + a, j + b, k + c, d]
    return True


@njit(cache=True)
def _lookup_many(field, sd, origin, spacing, points, out, is_known):  # type: ignore[no-untyped-def]
    row = np.zeros(13)
    for n in range(len(points)):
        is_known[n] = interpolate(field, sd, origin, spacing, points[n], row)
        if is_known[n]:
            out[n] = row
