# SPDX-License-Identifier: BSD-3-Clause
"""Blending of overlapping tiles by smooth shares that sum to one."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from magmatch.field.linear_model import Index
from magmatch.field.spline.spline_model import SplinePosterior
from magmatch.field.tiles.tiles import TileKeys, Tiling
from magmatch.field.values import FieldValues
from magmatch.typing import Indices, Points, Vector3

# Rounding leaves shares that sum to one but for this.
SMALLEST_SHARE = 1e-12
# A tile's number, the rows of points where it has a say, and its share there with derivatives.
Share = tuple[int, Indices, list[np.ndarray]]


def tile_shares(tiling: Tiling, tiles: list[Index], keys: TileKeys, points: Points, order: int) -> Iterator[Share]:
    """Each tile with a say at some points."""
    for number, rows in tiling.blended(points, keys):
        along = [tiling.axis_weights(points[rows, a], tiles[number][a]) for a in range(3)]
        yield number, rows, products(along, order)


def blended_values(
    points: Points, order: int, constant: Vector3, shares: Iterable[Share],
    evaluate: Callable[[int, Points], FieldValues],
) -> FieldValues:  # fmt: skip
    """Sum of tiles' values times their shares, by the product rule; the rest of the shares is a constant field.

    ``evaluate`` gives the values of a tile by its number.
    """
    n = len(points)
    field = np.tile(constant, (n, 1))
    gradient = np.zeros((n, 3, 3)) if order >= 1 else None
    second = np.zeros((n, 3, 3, 3)) if order >= 2 else None
    for number, rows, share in shares:
        values, w = evaluate(number, points[rows]), share[0]
        B, G = values.field - constant, values.gradient
        field[rows] += w[:, None] * B
        if gradient is not None and G is not None:
            dw = share[1]
            gradient[rows] += w[:, None, None] * G + B[:, :, None] * dw[:, None, :]
        if second is not None and G is not None and values.second is not None:
            mixed = G[:, :, :, None] * dw[:, None, None, :]
            second[rows] += (
                w[:, None, None, None] * values.second
                + mixed + mixed.transpose(0, 1, 3, 2)
                + B[:, :, None, None] * share[2][:, None]
            )  # fmt: skip
    return FieldValues(field, gradient, second)


def blended_covariance(
    points: Points, order: int, outside: np.ndarray, shares: list[Share], tile: Callable[[int], SplinePosterior]
) -> np.ndarray:
    """Bound of the covariance of field (and gradient) at each point; ``outside`` where no tile is.

    With ``e`` the error of a tile, that of the blend's gradient is ``sum w (grad e + e grad w / w)``; the bound
    by convexity is the mean of the covariances of these terms, and finite since ``|grad w|^2 / w`` is.
    """
    out, left = np.zeros((len(points), *outside.shape)), np.ones(len(points))
    for number, rows, share in shares:
        w, covariance = share[0], tile(number).covariance(points[rows], order)
        if order == 1:
            covariance = _with_slope(covariance, share[1] / np.maximum(w, SMALLEST_SHARE)[:, None])
        out[rows] += w[:, None, None] * covariance
        left[rows] -= w
    is_left = left > SMALLEST_SHARE
    out[is_left] += left[is_left, None, None] * outside
    return out


def products(along: list[list[np.ndarray]], order: int) -> list[np.ndarray]:
    """A product of one function per axis, its gradient (n, 3) and Hessian (n, 3, 3), from their derivatives."""
    out = [_differentiated(along)]
    if order >= 1:
        out.append(np.stack([_differentiated(along, a) for a in range(3)], axis=1))
    if order >= 2:
        hessian = np.empty((len(out[0]), 3, 3))
        for a, b in np.ndindex(3, 3):
            hessian[:, a, b] = _differentiated(along, a, b)
        out.append(hessian)
    return out


def _differentiated(along: list[list[np.ndarray]], *axes: int) -> np.ndarray:
    """The product's derivative along some axes."""
    x, y, z = (one[axes.count(axis)] for axis, one in enumerate(along))
    return np.asarray(x * y * z)


def _with_slope(covariance: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Covariance (n, 12, 12) of (e, grad e + e slope) from that of (e, grad e)."""
    transform = np.tile(np.eye(12), (len(covariance), 1, 1))
    for a, b in np.ndindex(3, 3):
        transform[:, 3 + 3 * a + b, a] = slope[:, b]
    return np.asarray(transform @ covariance @ transform.transpose(0, 2, 1))
