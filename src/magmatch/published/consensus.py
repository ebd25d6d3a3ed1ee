# SPDX-License-Identifier: BSD-3-Clause
"""`consensus`: vector MSAC, the rigid transform that most matches agree on by points and by field vectors."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.candidate_poses import distinct_poses
from magmatch.features.extract import Features
from magmatch.geometry import rotation_matrix, transform_of, unit_vectors
from magmatch.published.matching import Matches
from magmatch.settings import Settings
from magmatch.typing import Indices, Mask, Points, Scalars, Tensors, Vector3, Vectors

# Hypothesis-correspondence pairs scored at once: bounds memory.
_PAIRS_AT_ONCE = 1_000_000
# Refits of one hypothesis to its inliers; the set converges within a few.
_MAX_REFITS = 20
# Transforms nearer than this (and one inlier distance) are one candidate, rad.
_SAME_ROTATION = 0.1


class ConsensusConfig(Settings):
    """How hypotheses are drawn and judged."""

    # Distance at which the cost of a correspondence is truncated, spacings of X*. Experiment: one spacing, the offset
    # that two unaligned grids leave, halves the error of two spacings, which include neighbouring keypoints.
    inlier_distance: float = Field(default=1.0, gt=0)
    # What a right angle between aligned vectors costs, inlier distances; 0 is the classical MSAC (experiment).
    vector_weight: float = Field(default=10.0, ge=0)
    # Correspondences per hypothesis (published: 3 points); 2 suffice where vectors fix the rotation about their line.
    sample_size: int = Field(default=3, ge=2, le=6)
    # Samples drawn, and most hypotheses that are scored among those whose distances agree.
    n_samples: int = Field(default=100_000, ge=1)
    n_hypotheses: int = Field(default=2000, ge=1)
    # Best hypotheses that are refitted to their inliers, and distinct transforms handed on.
    n_refits: int = Field(default=20, ge=1)
    n_candidates: int = Field(default=5, ge=1)
    # Fewest inliers of a transform worth reporting.
    min_inliers: int = Field(default=6, ge=3)


@dataclass(frozen=True, eq=False, slots=True)
class Consensus:
    """A transform and the matches that support it.

    Attributes
    ----------
    T_base_target : RigidTransform
    cost : float
        Mean truncated cost over all matches, 0 (all agree) to 1 (none does).
    is_inlier : (c,) array of bool
        Which matches support it.
    """

    T_base_target: RigidTransform
    cost: float
    is_inlier: Mask

    def __repr__(self) -> str:
        return f"Consensus(cost {self.cost:.3g}, {int(self.is_inlier.sum())} of {len(self.is_inlier)} matches)"


@dataclass(frozen=True, eq=False, slots=True)
class _Pairs:
    """Correspondences in units of the inlier distance; directions are unit vectors."""

    base: Points
    target: Points
    base_direction: Vectors
    target_direction: Vectors
    vector_weight: float


def consensus(
    base: Features,
    target: Features,
    matches: Matches,
    spacing: float,
    config: ConsensusConfig | None = None,
    seed: int = 0,
) -> list[Consensus]:
    """Find transforms that align the keypoints and the field vectors of many matches.

    Parameters
    ----------
    base, target : Features
        Keypoints of both maps.
    matches : Matches
        Which of them correspond.
    spacing : float, m
        Distance of neighbouring points of X*: the unit of `ConsensusConfig.inlier_distance`.
    config : ConsensusConfig, optional
        How hypotheses are drawn and judged.
    seed : int
        Of the draws.

    Returns
    -------
    list of Consensus
        Distinct transforms, lowest cost first; empty if none has enough inliers.

    References
    ----------
    P. Torr, A. Zisserman, MLESAC, Computer Vision and Image Understanding 78(1), 2000 (MSAC).
    """
    config, a, b = config or ConsensusConfig(), matches.base_rows, matches.target_rows
    return vector_msac(
        base.positions[a], target.positions[b], base.field[a], target.field[b],
        config.inlier_distance * spacing, config, np.random.default_rng(seed),
    )  # fmt: skip


def vector_msac(
    base_points: Points,
    target_points: Points,
    base_field: Vectors,
    target_field: Vectors,
    inlier_distance: float,
    config: ConsensusConfig,
    rng: np.random.Generator,
) -> list[Consensus]:
    """Distinct transforms that align the points and vectors of many correspondences, lowest cost first.

    Row i of the base's points (m) and vectors (T) corresponds to row i of the target's. ``cost = mean_i min(d_i^2 +
    (w c_i)^2, 1)``: d_i is the distance of the points in inlier distances, c_i the norm of the cross product of the
    unit vectors after rotation (1 where they are opposed), w the weight of vectors. Empty if no transform has enough
    inliers.
    """
    pairs = _Pairs(
        base_points / inlier_distance,
        target_points / inlier_distance,
        unit_vectors(base_field),
        unit_vectors(target_field),
        config.vector_weight,
    )
    if len(pairs.base) < max(config.sample_size, config.min_inliers):
        return []
    samples = consistent_samples(pairs, config, rng)
    R, t = fit_rigid(pairs, samples)
    center = target_points.mean(axis=0) / inlier_distance
    best = _distinct(R, t, _mean_costs(pairs, R, t), center, config.n_refits)
    settled = [_settle(pairs, R[h], t[h], inlier_distance) for h in best]
    supported = [c for c in settled if c.is_inlier.sum() >= config.min_inliers]
    if not supported:
        return []
    R = np.stack([rotation_matrix(c.T_base_target) for c in supported])
    t = np.stack([c.T_base_target.translation for c in supported]) / inlier_distance
    costs = np.array([c.cost for c in supported])
    return [supported[k] for k in _distinct(R, t, costs, center, config.n_candidates)]


def consistent_samples(pairs: _Pairs, config: ConsensusConfig, rng: np.random.Generator) -> np.ndarray:
    """Draw small sets of correspondences whose mutual distances agree in both maps.

    A rigid transform preserves distances, so in a set that is dropped, not all members could have been inliers. Sets
    whose points nearly coincide are dropped too, since they do not determine a rotation.
    """
    n, size = len(pairs.base), config.sample_size
    drawn = rng.integers(0, n, (config.n_samples, size))
    is_good = np.ones(len(drawn), dtype=bool)
    for i in range(size):
        for j in range(i):
            one, other = drawn[:, i], drawn[:, j]
            in_base = np.linalg.norm(pairs.base[one] - pairs.base[other], axis=1)
            in_target = np.linalg.norm(pairs.target[one] - pairs.target[other], axis=1)
            # In inlier distances: both ends may be off by one.
            is_good &= (np.abs(in_base - in_target) < 2) & (np.minimum(in_base, in_target) > 1)
    return drawn[is_good][: config.n_hypotheses]


def fit_rigid(pairs: _Pairs, samples: np.ndarray) -> tuple[Tensors, Vectors]:
    """Least-squares rotations (h, 3, 3) and translations (h, 3) of points and directions together.

    Minimises ``sum_i |R y_i + t - x_i|^2 + w^2 |R v_i - u_i|^2`` by the singular value decomposition of ``sum_i
    (x_i - x)(y_i - y)^T + w^2 u_i v_i^T`` (Kabsch; Wahba for the directions), x and y the means.
    """
    x, y = pairs.base[samples], pairs.target[samples]
    x_mean, y_mean = x.mean(axis=1), y.mean(axis=1)
    M = np.einsum("hmi,hmj->hij", x - x_mean[:, None], y - y_mean[:, None])
    u, v = pairs.base_direction[samples], pairs.target_direction[samples]
    M += pairs.vector_weight**2 * np.einsum("hmi,hmj->hij", u, v)
    U, _, Vt = np.linalg.svd(M)
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    R = U @ Vt
    return R, x_mean - np.einsum("hij,hj->hi", R, y_mean)


def squared_costs(pairs: _Pairs, R: Tensors, t: Vectors) -> np.ndarray:
    """Cost of each correspondence under each transform before truncation: (h, c), in squared inlier distances."""
    d2 = ((pairs.target @ np.swapaxes(R, 1, 2) + t[:, None] - pairs.base) ** 2).sum(axis=2)
    cosine = np.einsum("hci,ci->hc", pairs.target_direction @ np.swapaxes(R, 1, 2), pairs.base_direction)
    # |u x v|^2 = 1 - cos^2; opposed vectors, whose cross product vanishes too, cost as much as a right angle.
    sine2 = 1 - np.clip(cosine, 0, 1) ** 2
    return np.asarray(d2 + pairs.vector_weight**2 * sine2)


def _mean_costs(pairs: _Pairs, R: Tensors, t: Vectors) -> Scalars:
    step = max(_PAIRS_AT_ONCE // len(pairs.base), 1)
    parts = [
        np.minimum(squared_costs(pairs, R[k : k + step], t[k : k + step]), 1).mean(axis=1)
        for k in range(0, len(R), step)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def _settle(pairs: _Pairs, R: np.ndarray, t: np.ndarray, inlier_distance: float) -> Consensus:
    """Fit to the inliers until they no longer change."""
    costs = squared_costs(pairs, R[None], t[None])[0]
    is_inlier = costs < 1
    for _ in range(_MAX_REFITS):
        rows = np.flatnonzero(is_inlier)[None]
        if rows.shape[1] < 3:
            break
        fitted, shift = fit_rigid(pairs, rows)
        R, t = fitted[0], shift[0]
        costs = squared_costs(pairs, fitted, shift)[0]
        was, is_inlier = is_inlier, costs < 1
        if np.array_equal(was, is_inlier):
            break
    T = transform_of(R, t * inlier_distance)
    return Consensus(T, float(np.minimum(costs, 1).mean()), is_inlier)


def _distinct(R: Tensors, t: Vectors, costs: Scalars, center: Vector3, limit: int) -> Indices:
    """Rows of the transforms with the lowest cost, without near-duplicates of a better one."""
    return distinct_poses(R, R @ center + t, -costs, _SAME_ROTATION, 1.0, limit)
