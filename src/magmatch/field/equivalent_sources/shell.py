# SPDX-License-Identifier: BSD-3-Clause
"""Equivalent sources: point charges on a layer that encloses a region, a basis of the fields without sources in it.

Any field whose sources all lie outside a region equals, in it, that of a layer of charges around it (a single-layer
potential). The layer follows the samples, not their box: furniture may stand in a corner of the box that no sample is
near, and the box of a room turned against the model's axes holds the room's own walls.

Magnetic charges do not exist, but a layer of them outside a region represents any field without sources inside it.
The field of each is exactly curl-free and divergence-free away from the charge. Only distinct derivatives are formed,
in the order of `spline_basis.derivative_table`.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from magmatch.compiled import allocating, compiled
from magmatch.field.inducing.kernels import N_ROWS
from magmatch.field.spline.spline_basis import GRADIENT_INDEX, SECOND_INDEX, derivative_table, values_of
from magmatch.field.values import FieldValues
from magmatch.typing import Mask, Matrix, Points, Scalars, Vector3

log = logging.getLogger(__name__)

# Points of the region over which the basis is scaled to unit variance.
_N_SCALED = 500
# Where the basis can be asked, in distances of the layer: nearer to it single charges would show.
_REACH_RATIO = 0.75
# Most nodes of the lattice that the surface is found on.
MOST_NODES = 2e6
# How often nodes are moved onto the surface: the nearest point changes on the way.
_N_MOVES = 2
# Least distance of charges, in spacings.
_THINNED_TO = 0.8
# Spacings of the layer, in its distances: denser adds weights that say nothing new, wider shows single charges.
_SPACING_RATIOS = (0.35, 1.2)


@dataclass(frozen=True, eq=False, slots=True)
class SourceShell:
    """Charges around a region; fills `inducing.inducing_model.Basis` with unit prior variance in the region."""

    sources: Points  # (m, 3), m
    region: cKDTree  # points of the region
    distance: float  # m: of the sources from the nearest point of the region
    spacing: float  # m: of neighbouring sources
    scale: Scalars  # (m,), m^2: charge per unit weight of each source
    inner: cKDTree | None = None  # those sources that stand nearer than the layer, among the samples or next to them
    inner_distance: float = 0.0  # m: of these from any sample, at least

    @property
    def n_weights(self) -> int:
        """One per charge."""
        return len(self.sources)

    def is_whole(self, points: Points) -> Mask:
        """Say where the basis alone is the prior: near the region, not next to a charge. Elsewhere it is silent."""
        near, _ = self.region.query(points, distance_upper_bound=_REACH_RATIO * self.distance)
        is_near = np.isfinite(near)
        if self.inner is None:
            return is_near
        beside, _ = self.inner.query(points, distance_upper_bound=(1 - _REACH_RATIO) * self.inner_distance)
        return is_near & ~np.isfinite(beside)

    def with_charges(self, charges: Points, scale: Scalars, samples: Points) -> "SourceShell":
        """Add further charges, each of its own scale, among or next to samples."""
        sources = np.ascontiguousarray(np.concatenate([self.sources, charges]))
        scales, distance = np.concatenate([self.scale, scale]), float(np.min(cKDTree(samples).query(charges)[0]))
        return replace(self, sources=sources, scale=scales, inner=cKDTree(charges), inner_distance=distance)

    def design(self, points: Points, order: int = 0) -> Matrix:
        """Field and derivatives per unit of each weight, component-major rows: (rows n, m)."""
        n, is_near = len(points), self.is_whole(points)
        distinct = charge_design(np.ascontiguousarray(points[is_near]), self.sources, order)
        distinct *= self.scale
        if order == 0 and is_near.all():
            # Nothing to sort out: a large survey's matrix need not be copied.
            return distinct.reshape(-1, self.n_weights)
        out = np.zeros((N_ROWS[order], n, self.n_weights))
        out[:, is_near] = distinct[_row_index(order)]
        return out.reshape(-1, self.n_weights)

    def evaluate(self, points: Points, weights: np.ndarray, order: int, constant: Vector3) -> FieldValues:
        """Field and derivatives at points; the constant alone away from the region."""
        is_near = self.is_whole(points)
        out = np.zeros((len(points), len(derivative_table(order))))
        near = np.ascontiguousarray(points[is_near])
        out[is_near] = charge_field(near, self.sources, self.scale * weights, order)
        return values_of(out, constant, order)


def lay_shell(
    region: Points, distance: float, spacing: float, max_sources: int, farthest: float = np.inf
) -> SourceShell:
    """Charges evenly on the surface at a distance from the nearest point of a region.

    Where they would be too many, distance and spacing (m) are widened alike, but no more once they are ``farthest``.
    """
    ratio = float(np.clip(spacing / distance, *_SPACING_RATIOS))
    tree = cKDTree(region)
    h = _affordable(ratio * distance, np.ptp(region, axis=0), ratio)
    while True:
        sources = _on_surface(region, tree, h / ratio, h)
        if 0 < len(sources) <= max_sources or h / ratio > farthest:
            break
        h *= max(1.02, (len(sources) / max_sources) ** 0.5)
    some = np.ascontiguousarray(region[:: -(-len(region) // _N_SCALED)])
    variance = float((charge_design(some, sources, 0) ** 2).sum() / (3 * len(some)))
    return SourceShell(sources, tree, h / ratio, h, np.full(len(sources), variance**-0.5))


def charge_design(points: Points, sources: Points, order: int) -> np.ndarray:
    """Field and distinct derivatives at points per unit charge."""
    out = np.empty((len(derivative_table(order)), len(points), len(sources)))
    _fill(points, sources, order, out)
    return out


@allocating
def _fill(points: np.ndarray, sources: np.ndarray, order: int, out: np.ndarray) -> None:
    row = np.zeros(out.shape[0])
    for i in range(len(points)):
        for j in range(len(sources)):
            _rows(
                points[i, 0] - sources[j, 0], points[i, 1] - sources[j, 1], points[i, 2] - sources[j, 2], order, row
            )  # fmt: skip
            for k in range(len(row)):
                out[k, i, j] = row[k]


@compiled
def _rows(x: float, y: float, z: float, order: int, out: np.ndarray) -> None:
    """Field and distinct derivatives of a unit charge at offset (x, y, z) from it."""
    q = 1.0 / (x * x + y * y + z * z)
    a = q * np.sqrt(q)
    out[0], out[1], out[2] = a * x, a * y, a * z
    if order == 0:
        return
    b = -3.0 * a * q
    out[3], out[4], out[5] = a + b * x * x, b * x * y, b * x * z
    out[6], out[7], out[8] = a + b * y * y, b * y * z, a + b * z * z
    if order == 1:
        return
    c = -5.0 * b * q
    out[9] = x * (3 * b + c * x * x)
    out[10], out[11] = y * (b + c * x * x), z * (b + c * x * x)
    out[12], out[13], out[14] = x * (b + c * y * y), c * x * y * z, x * (b + c * z * z)
    out[15] = y * (3 * b + c * y * y)
    out[16], out[17] = z * (b + c * y * y), y * (b + c * z * z)
    out[18] = z * (3 * b + c * z * z)


def _row_index(order: int) -> np.ndarray:
    """Which distinct derivative each row of `N_ROWS` is."""
    index = [np.arange(3), 3 + GRADIENT_INDEX.ravel(), 9 + SECOND_INDEX.ravel()]
    return np.concatenate(index[: order + 1])


def charge_field(points: Points, sources: Points, charges: Scalars, order: int) -> Matrix:
    """Field and distinct derivatives at points of given charges (T m^2): (n, 3, 9 or 19), T, T/m, T/m^2."""
    out = np.zeros((len(points), len(derivative_table(order))))
    _sum(points, sources, charges, order, out)
    return out


@allocating
def _sum(points: np.ndarray, sources: np.ndarray, charges: np.ndarray, order: int, out: np.ndarray) -> None:
    row = np.zeros(out.shape[1])
    for i in range(len(points)):
        for j in range(len(sources)):
            _rows(
                points[i, 0] - sources[j, 0], points[i, 1] - sources[j, 1], points[i, 2] - sources[j, 2], order, row
            )  # fmt: skip
            for k in range(len(row)):
                out[i, k] += charges[j] * row[k]


def _affordable(h: float, extent: np.ndarray, ratio: float) -> float:
    """The spacing asked for, or the least wider one at which the lattice of the surface is small enough."""
    while np.prod(2 * extent / h + 6 / ratio) > MOST_NODES:
        h *= 1.1
    return h


def _on_surface(region: Points, tree: cKDTree, distance: float, h: float) -> Points:
    """Points about h apart at a distance from a region.

    The nodes of a lattice half as wide that lie near the surface are moved onto it, then thinned. Left on the
    lattice they would make a layer of uneven thickness: its evidence jumps with the distance, and the error is a
    tenth larger.
    """
    nodes = _near_surface(region, distance, h / 2)
    away, _ = tree.query(nodes)
    nodes = nodes[np.abs(away - distance) <= h / 4]
    for _ in range(_N_MOVES):
        found = tree.query(nodes)
        away, nearest = np.asarray(found[0]), np.asarray(found[1])
        nodes = region[nearest] + (nodes - region[nearest]) * (distance / away)[:, None]
    pairs = cKDTree(nodes).query_pairs(_THINNED_TO * h, output_type="ndarray")
    return np.ascontiguousarray(nodes[_first_of(pairs[np.lexsort(pairs.T[::-1])], len(nodes))])


def _near_surface(region: Points, distance: float, step: float) -> Points:
    """Nodes of a lattice whose distance from the region is right to about a step."""
    from scipy.ndimage import distance_transform_edt

    low, high = region.min(axis=0), region.max(axis=0)
    margin = int(np.ceil(distance / step)) + 2
    n_steps = np.ceil((high - low) / step - 1e-9)
    origin = (low + high - n_steps * step) / 2 - margin * step
    is_free = np.ones((n_steps.astype(np.int64) + 1 + 2 * margin), dtype=np.bool_)
    is_free[tuple(np.rint((region - origin) / step).astype(np.int64).T)] = False
    away = step * distance_transform_edt(is_free)
    return np.asarray(origin + step * np.argwhere(np.abs(away - distance) <= 1.4 * step))


@allocating
def _first_of(pairs: np.ndarray, n: int) -> np.ndarray:
    """Points of which no earlier one that stays is a close neighbour; pairs in ascending order."""
    stays = np.ones(n, dtype=np.bool_)
    for k in range(len(pairs)):
        if stays[pairs[k, 0]]:
            stays[pairs[k, 1]] = False
    return stays
