# SPDX-License-Identifier: BSD-3-Clause
"""A map's field and standard deviation on a grid, for the many cheap trilinear look-ups of a search."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from magmatch.compiled import compiled_ahead, record, subroutine
from magmatch.estimation.candidate_poses import OUTLIER_SHARE
from magmatch.estimation.limits import MAX_RASTER, MAX_REFINED
from magmatch.estimation.pose_prior import RARE
from magmatch.field.map import FieldMap
from magmatch.grid import RegularGrid
from magmatch.typing import Indices, Mask, Points, Scalars, Tensors, Vectors


class Raster(NamedTuple):
    """Field and standard deviation at the points of a grid, in the map's model frame."""

    origin: np.ndarray  # (3,), m, model frame
    spacing: float  # m
    # (nx, ny, nz, 4), T: field, and standard deviation of one component (negative where the map does not know the
    # field); stored together, since both are looked up together
    values: np.ndarray

    @classmethod
    def knowing(
        cls, origin: np.ndarray, spacing: float, shape: tuple[int, ...], rows: Indices, field: Vectors, sd: Scalars
    ) -> Self:
        """Raster of shape (nx, ny, nz) that knows the field only at some points: rows of the flattened grid."""
        values = np.zeros((int(np.prod(shape)), 4))
        values[:, 3] = -1.0
        values[rows, :3], values[rows, 3] = field, sd
        # A copy: loops are compiled anew for an array that cannot be written, as those of a file.
        return cls(np.array(origin), spacing, values.reshape(*shape, 4))

    @property
    def field(self) -> np.ndarray:
        """Field at the grid's points: (nx, ny, nz, 3), T."""
        return self.values[..., :3]

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of one component, negative where unknown: (nx, ny, nz), T."""
        return self.values[..., 3]

    @property
    def volume(self) -> float:
        """Volume of the region that the map knows, m^3."""
        return float((self.sd >= 0).sum() * self.spacing**3)

    @property
    def whole_share(self) -> float:
        """Share of the cells with a known corner that can be looked up."""
        corners = sliding_window_view(self.sd >= 0, (2, 2, 2)).sum(axis=(3, 4, 5))
        return float((corners == 8).sum() / max((corners > 0).sum(), 1))

    def lookup(self, points: Points) -> tuple[Vectors, Scalars, Tensors, Mask]:
        """Field and spread (T), gradient (T/m) and whether known, by trilinear interpolation; 0 where unknown."""
        out = np.zeros((len(points), 13))
        is_known = np.zeros(len(points), dtype=np.bool_)
        _lookup_many(self, np.ascontiguousarray(points), out, is_known)
        return out[:, :3], out[:, 3], out[:, 4:].reshape(-1, 3, 3), is_known


RASTER = record(Raster, "f8[::1], f8, f8[:,:,:,::1]")


def rasterize(field_map: FieldMap, spacing: float, draws: Sequence[Any]) -> Raster:
    """Evaluate a map on a grid laid along its own model axes."""
    samples = field_map.survey.transformed(field_map.T_map_model.inv()).positions
    while True:
        raster = _rasterize(field_map, samples, spacing, draws)
        *_, is_known = raster.lookup(samples)
        # On a coarse grid, a thin layer may fall between the points, and a line may lose its surroundings.
        is_lost = is_known.mean() < 1 - RARE and raster.sd.size < MAX_RASTER / 8
        # Partly known cells match nothing. Around a line most cells are such: half of the known region would be lost.
        is_ragged = raster.whole_share < 1 - OUTLIER_SHARE and 8 * (raster.sd >= 0).sum() < MAX_REFINED
        if raster.spacing > spacing or not (is_lost or is_ragged):
            return raster
        spacing /= 2


def _rasterize(field_map: FieldMap, samples: Points, spacing: float, draws: Sequence[Any]) -> Raster:
    posterior = field_map.posterior
    margin = 2 * spacing
    extent = np.ptp(samples, axis=0) + 2 * margin
    spacing = max(spacing, float(np.cbrt(np.prod(np.maximum(extent, spacing)) / MAX_RASTER)))
    grid = RegularGrid.over(samples, spacing, margin)
    points = grid.points()
    rows = np.flatnonzero(posterior.knows(points))
    mean = posterior.evaluate(points[rows]).field
    power = np.zeros(len(rows))
    for weights in draws:
        power += ((posterior.evaluate(points[rows], 0, weights).field - mean) ** 2).mean(axis=1)
    sd = np.sqrt(power / len(draws))
    return Raster.knowing(grid.T_map_grid.translation, spacing, grid.shape, rows, mean, sd)


@subroutine
def find_cell(values, origin, spacing, x, y, z):  # type: ignore[no-untyped-def]
    """Lowest corner (-1 where a corner is missing or unknown) and position in the cell, 0 to 1."""
    u, v, w = (x - origin[0]) / spacing, (y - origin[1]) / spacing, (z - origin[2]) / spacing
    i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
    if i < 0 or j < 0 or k < 0 or i >= values.shape[0] - 1 or j >= values.shape[1] - 1 or k >= values.shape[2] - 1:
        return -1, 0, 0, u, v, w
    for a in range(i, i + 2):
        for b in range(j, j + 2):
            if values[a, b, k, 3] < 0 or values[a, b, k + 1, 3] < 0:
                return -1, 0, 0, u, v, w
    return i, j, k, u - i, v - j, w - k


@subroutine
def interpolate_field(values, i, j, k, u, v, w):  # type: ignore[no-untyped-def]
    """Trilinear field and sd in a cell."""
    bx, by, bz, sd = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        wx = u if a else 1 - u
        for b in range(2):
            wxy = wx * (v if b else 1 - v)
            low, high = values[i + a, j + b, k], values[i + a, j + b, k + 1]
            w0, w1 = wxy * (1 - w), wxy * w
            bx += w0 * low[0] + w1 * high[0]
            by += w0 * low[1] + w1 * high[1]
            bz += w0 * low[2] + w1 * high[2]
            sd += w0 * low[3] + w1 * high[3]
    return bx, by, bz, sd


@subroutine
def interpolate(values, spacing, i, j, k, u, v, w, out):  # type: ignore[no-untyped-def]
    """Trilinear field (out[:3]), sd (out[3]) and gradient (out[4:13], row-major dB_a/dx_b) in a cell."""
    for d in range(4):
        f000, f001 = values[i, j, k, d], values[i, j, k + 1, d]
        f010, f011 = values[i, j + 1, k, d], values[i, j + 1, k + 1, d]
        f100, f101 = values[i + 1, j, k, d], values[i + 1, j, k + 1, d]
        f110, f111 = values[i + 1, j + 1, k, d], values[i + 1, j + 1, k + 1, d]
        f00, f01 = f000 + w * (f001 - f000), f010 + w * (f011 - f010)
        f10, f11 = f100 + w * (f101 - f100), f110 + w * (f111 - f110)
        f0, f1 = f00 + v * (f01 - f00), f10 + v * (f11 - f10)
        out[d] = f0 + u * (f1 - f0)
        if d < 3:
            out[4 + 3 * d] = (f1 - f0) / spacing
            out[5 + 3 * d] = ((1 - u) * (f01 - f00) + u * (f11 - f10)) / spacing
            dz0 = (1 - v) * (f001 - f000) + v * (f011 - f010)
            dz1 = (1 - v) * (f101 - f100) + v * (f111 - f110)
            out[6 + 3 * d] = ((1 - u) * dz0 + u * dz1) / spacing


@compiled_ahead(RASTER, "f8[:,::1], f8[:,::1], b1[::1]")
def _lookup_many(raster, points, out, is_known):  # type: ignore[no-untyped-def]
    origin, spacing, values = raster
    for n in range(len(points)):
        i, j, k, u, v, w = find_cell(values, origin, spacing, points[n, 0], points[n, 1], points[n, 2])
        is_known[n] = i >= 0
        if i >= 0:
            interpolate(values, spacing, i, j, k, u, v, w, out[n])
