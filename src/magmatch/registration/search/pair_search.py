# SPDX-License-Identifier: BSD-3-Clause
"""Global search for a short walk by pairs of points, since the gradient across a line is unknown."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from magmatch.estimation.candidate_poses import CandidatePoses
from magmatch.estimation.cubes import SAMPLING, even_choice, thin
from magmatch.estimation.limits import COARSER, FEW_POINTS, MAX_PAIRS, MORE_NEIGHBOURS, N_LIKE_PAIRS
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.features.pairs import align_pairs, pair_invariants, whiten_pairs
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.invariant_search import best_admitted, coarse_poses
from magmatch.registration.search.kdtree import EVERY_LEAF, NeighbourTree
from magmatch.registration.search.scoring import Evidence
from magmatch.typing import Indices, Matrix, Points, Vectors

# Shortest and longest pair, in the base's correlation length.
MIN_DISTANCE, MAX_DISTANCE = 0.8, 6.2


@dataclass(frozen=True, eq=False, slots=True)
class PairTable:
    """All pairs of base points that a walk can be compared with, indexed by their invariants; base model frame."""

    positions: Points  # (k, 3), m
    field: Vectors  # (k, 3), T
    first: Indices  # (p,) ints: rows of the points that make each pair
    second: Indices
    tree: NeighbourTree  # of the whitened invariants
    length: float  # m: the base's correlation length
    # m and T: expected differences when another walk passes a point; for whitening and alignment
    sd_position: float
    sd_field: float
    # T and T/m: typical strength of the field, and rms of one component of its gradient
    field_norm: float
    gradient_rms: float

    @classmethod
    def empty(cls, length: float) -> "PairTable":
        """That of a base in which nothing is searched."""
        none, points = np.zeros(0, np.int64), np.zeros((0, 3))
        return cls(points, points, none, none, NeighbourTree.of(points), length, 0.0, 0.0, 0.0, 0.0)

    def nearest(self, invariants: Matrix, k: int, n_leaves: int = EVERY_LEAF) -> tuple[Indices, Matrix]:
        """Rows (n, k) of the pairs with the most similar invariants, and their squared distances, in sd^2."""
        whitened = whiten_pairs(invariants, self.sd_position, self.sd_field, self.field_norm)
        return self.tree.query(whitened, min(k, len(self.first)), n_leaves)


def tabulate_pairs(base: PreparedMap, noise_sd: float) -> PairTable:
    """List the base's pairs of points; one table serves any number of walks."""
    length = base.correlation_length
    is_known = base.raster.lookup(base.points)[3]
    x, b, G = base.points[is_known], base.point_field[is_known], base.point_gradient[is_known]
    rows, pairs = _pairs(x, length)
    # Another walk passes half-way between two points.
    sd_position = SAMPLING / 2 * length
    gradient_rms = float(np.sqrt(np.mean(G**2))) if len(G) else 0.0
    sd_field = float(np.hypot(noise_sd, np.sqrt(3) * gradient_rms * sd_position))
    field_norm = float(np.median(np.linalg.norm(b, axis=1))) if len(b) else 0.0
    x, b = x[rows], b[rows]
    i, j = pairs[:, 0], pairs[:, 1]
    invariants = whiten_pairs(pair_invariants(x[i], x[j], b[i], b[j]), sd_position, sd_field, field_norm)
    return PairTable(
        x, b, i, j, NeighbourTree.of(invariants), length, sd_position, sd_field, field_norm, gradient_rms
    )


def pair_search(
    base: PreparedMap,
    table: PairTable,
    walk: Walk,
    prior: PosePrior,
    rng: np.random.Generator,
) -> SearchResult:
    """Find the poses under which the base's field explains a walk best."""
    i, j = choose_pairs(walk, table, FEW_POINTS, rng)
    if not len(i) or not len(table.first):
        return SearchResult()
    center = walk.positions.mean(axis=0)
    n_neighbours = N_LIKE_PAIRS * (1 if prior.is_flat else MORE_NEIGHBOURS)
    similar, _ = table.nearest(invariants_of(walk, i, j), n_neighbours)
    found, evidence = pair_poses(table, walk, i, j, similar), weigh_bins(base, table, walk)
    rows = np.tile(even_choice(len(walk), FEW_POINTS), (len(i), 1))
    # As many distinct poses are refined as pairs propose.
    poses, scores = coarse_poses(found, rows, evidence, base, prior, center, table.length, FEW_POINTS, rng)
    if not len(scores):
        return SearchResult()
    return SearchResult(
        best_admitted(poses, scores, prior, center, table.length),
        n_keypoints=len(table.positions) + len(walk),
        n_correspondences=len(found.rotations),
    )


def choose_pairs(walk: Walk, table: PairTable, n_pairs: int, rng: np.random.Generator) -> tuple[Indices, Indices]:
    """Draw pairs of bins (rows of the walk), long ones with differing fields first; none if the walk is too short."""
    i, j = np.triu_indices(len(walk), 1)
    d = np.linalg.norm(walk.positions[i] - walk.positions[j], axis=1)
    longest = MAX_DISTANCE * table.length - table.sd_position
    usable = np.flatnonzero((d > MIN_DISTANCE * table.length) & (d < longest))
    i, j, d = i[usable], j[usable], d[usable]
    change = np.linalg.norm(walk.field[i] - walk.field[j], axis=1)
    share = d * (table.sd_field + change)
    n = min(n_pairs, len(usable))
    chosen = rng.choice(len(usable), n, replace=False, p=share / share.sum()) if n else np.zeros(0, dtype=np.int64)
    return i[chosen].astype(np.int64), j[chosen].astype(np.int64)


def invariants_of(walk: Walk, i: Indices, j: Indices) -> Matrix:
    """Invariants of some pairs of bins: (n, 7)."""
    return pair_invariants(walk.positions[i], walk.positions[j], walk.field[i], walk.field[j])


def pair_poses(table: PairTable, walk: Walk, i: Indices, j: Indices, similar: Indices) -> CandidatePoses:
    """Poses that put each of the walk's pairs onto base pairs (n, k), each about the middle of its pair."""
    middles = (walk.positions[i] + walk.positions[j]) / 2
    a, b = table.first[similar.ravel()], table.second[similar.ravel()]
    rows = np.repeat(np.arange(len(i)), similar.shape[1])
    i, j = i[rows], j[rows]
    u = walk.positions[j] - walk.positions[i]
    R = align_pairs(
        (table.positions[b] - table.positions[a], table.field[a], table.field[b]),
        (u, walk.field[i], walk.field[j]),
        np.linalg.norm(u, axis=1),
        table.sd_position,
        table.sd_field,
    )
    return CandidatePoses(R, (table.positions[a] + table.positions[b]) / 2, rows, middles)


def _pairs(x: Points, length: float) -> tuple[Indices, Indices]:
    """Thinned points, and the pairs of them in both orders, as many as fit the table."""
    spacing = SAMPLING * length
    while True:
        rows = thin(x, spacing) if len(x) else np.zeros(0, dtype=np.int64)
        tree = cKDTree(x[rows]) if len(rows) else None
        n = tree.count_neighbors(tree, MAX_DISTANCE * length) if tree else 0
        if n <= MAX_PAIRS:
            break
        spacing *= COARSER
    pairs = np.zeros((0, 2), dtype=np.int64)
    if tree:
        pairs = tree.query_pairs(MAX_DISTANCE * length, output_type="ndarray").astype(np.int64)
        d = np.linalg.norm(x[rows][pairs[:, 0]] - x[rows][pairs[:, 1]], axis=1)
        pairs = pairs[d > MIN_DISTANCE * length]
    return rows, np.concatenate([pairs, pairs[:, ::-1]])


def weigh_bins(base: PreparedMap, table: PairTable, walk: Walk) -> Evidence:
    """Bins of the walk for scoring; under 'unrelated', each bin is expected to differ by the field's own spread.

    All bins have the same deviation, so that agreement with the walk's mean field counts as evidence too: on a short
    walk it is much of what there is.
    """
    deviation = walk.field - np.median(walk.field, axis=0)
    base_deviation = table.field - np.median(table.field, axis=0)
    variance = max(float(np.mean(deviation**2)), float(np.mean(base_deviation**2)))
    return Evidence(
        positions=walk.positions,
        field=walk.field,
        deviation2=np.full(len(walk), 3 * variance),
        deviation_variance=variance,
        noise_variance=max(base.noise_sd, 1e-12) ** 2,
        field_rms=float(np.sqrt((walk.field**2).sum(axis=1).mean() * 2 / 3)),
        gradient_rms=np.sqrt(3) * table.gradient_rms,
    )
