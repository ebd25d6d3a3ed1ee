# SPDX-License-Identifier: BSD-3-Clause
"""Global search without an initial guess: every point has a frame, so one pair of points gives a complete pose."""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform
from scipy.special import ndtri

from magmatch.compiled import compiled_ahead
from magmatch.estimation.candidate_poses import (
    OUTLIER_SHARE,
    CandidatePoses,
    distinct_poses,
    pose_inaccuracy,
    same_pose,
)
from magmatch.estimation.cubes import SAMPLING
from magmatch.estimation.limits import (
    FEW_POINTS,
    MORE_NEIGHBOURS,
    N_ANCHORS,
    N_CANDIDATES,
    N_COARSE,
    N_FINE,
    N_NEIGHBOURS,
    RANKING_POINTS,
)
from magmatch.estimation.pose_prior import PosePrior
from magmatch.features.invariants import point_frames
from magmatch.field.values import gradient_norm
from magmatch.progress import tell
from magmatch.registration.prepared.prepared_map import PreparedMap, common_length
from magmatch.registration.search.annealing import anneal_poses, schedule
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.search.scoring import Evidence, score_poses, weigh_samples
from magmatch.typing import Indices, Points, Scalars, Tensors, Vector3


def invariant_search(
    base: PreparedMap, target: PreparedMap, prior: PosePrior, rng: np.random.Generator
) -> SearchResult:
    """Find the poses under which the base's field explains the target's samples best."""
    anchors = choose_anchors(target, N_ANCHORS, rng)
    n_neighbours = N_NEIGHBOURS * (1 if prior.is_flat else MORE_NEIGHBOURS)
    neighbours = similar_points(base, target, anchors, n_neighbours)
    evidence, poses = weigh_samples(base, target), frame_poses(base, target, anchors, neighbours)
    rows = judging_samples(poses.anchors_target, target, FEW_POINTS, rng)
    length, center = common_length(base, target), target.samples.mean(axis=0)
    poses, scores = coarse_poses(poses, rows, evidence, base, prior, center, length, N_COARSE, rng)
    if not len(scores):
        return SearchResult()
    keep = distinct_poses(poses.rotations, poses.carry(center), scores, *same_pose(length), N_FINE)
    poses = poses.subset(keep)
    common = rng.permutation(len(target.samples))[:RANKING_POINTS]
    rows = np.tile(common, (len(anchors), 1))
    poses, scores = anneal_poses(poses, rows, evidence, base, schedule(1, pose_inaccuracy(length)), OUTLIER_SHARE)
    return SearchResult(
        best_admitted(poses, scores, prior, center, length),
        n_keypoints=len(base.points) + len(target.points),
        n_correspondences=int(neighbours.size),
    )


def coarse_poses(
    poses: CandidatePoses,
    rows: np.ndarray,
    evidence: Evidence,
    base: PreparedMap,
    prior: PosePrior,
    center: Vector3,
    length: float,
    n_coarse: int,
    rng: np.random.Generator,
) -> tuple[CandidatePoses, Scalars]:
    """Score poses that a prior admits, and refine the best distinct ones coarsely; gives them with their scores."""
    sd = pose_inaccuracy(length)
    poses = prior.narrow(poses, center, sd, rng)
    tell(f"scoring {len(poses.rotations)} poses")
    scores = score_poses(poses, rows, evidence, base, *sd, OUTLIER_SHARE)
    # A strong corner of the base attracts hundreds of near-duplicates, which would displace other poses.
    best = distinct_poses(poses.rotations, poses.carry(center), scores, *same_pose(length), n_coarse)
    tell("refining the best poses")
    return anneal_poses(poses.subset(best), rows, evidence, base, schedule(0, sd), OUTLIER_SHARE)


def choose_anchors(target: PreparedMap, n_anchors: int, rng: np.random.Generator) -> Indices:
    """Draw target points (rows) whose gradient is strong against its uncertainty."""
    g2, tiny = gradient_norm(target.point_gradient) ** 2, np.finfo(float).tiny
    # Between 0 and 1, and 1 in a uniform field: a very strong gradient is told no better than a strong one.
    share = (g2 + tiny) / (g2 + target.gradient_sd**2 + np.median(g2) + tiny)
    n = min(n_anchors, len(g2))
    return rng.choice(len(g2), n, replace=False, p=share / share.sum()).astype(np.int64)


def similar_points(base: PreparedMap, target: PreparedMap, anchors: Indices, n_neighbours: int) -> Indices:
    """Base points (a, k) whose invariants are nearest to those of each anchor, whitened by their uncertainty.

    Points stand half of `SAMPLING` apart, where invariants differ by that share of their spread over both maps.
    """
    both = np.concatenate([base.invariants, target.invariants])
    spread = np.median(np.abs(both - np.median(both, axis=0)), axis=0) / ndtri(0.75)
    scale = np.sqrt(
        np.median(base.invariant_sd, axis=0) ** 2
        + np.median(target.invariant_sd, axis=0) ** 2
        + (SAMPLING / 2 * spread) ** 2
        + np.finfo(float).tiny
    )
    k = min(n_neighbours, len(base.points))
    _, rows = cKDTree(base.invariants / scale).query(target.invariants[anchors] / scale, k=k)
    return np.asarray(rows, dtype=np.int64).reshape(len(anchors), k)


def judging_samples(anchors: Points, target: PreparedMap, n_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Samples (a, n) for scoring each anchor's poses: half within two lengthscales, the rest anywhere."""
    n = len(target.samples)
    rows = rng.integers(0, n, (len(anchors), n_samples))
    _near_first(
        anchors, target.samples, rng.permutation(n), (2 * target.correlation_length) ** 2, n_samples // 2, rows
    )
    return rows


@compiled_ahead("f8[:,::1], f8[:,::1], i8[::1], f8, i8, i8[:,::1]")
def _near_first(anchors, samples, shuffled, distance2, n_near, rows):  # type: ignore[no-untyped-def]
    """Fill the beginning of each anchor's row with samples near it, as far as there are; each starts elsewhere."""
    n = len(shuffled)
    for a in range(len(anchors)):
        found, start = 0, a * n // len(anchors)
        for q in range(n):
            row = shuffled[(start + q) % n]
            d2 = 0.0
            for c in range(3):
                step = samples[row, c] - anchors[a, c]
                d2 += step * step
            if d2 < distance2:
                rows[a, found] = row
                found += 1
                if found == n_near:
                    break


def best_admitted(
    poses: CandidatePoses, scores: Scalars, prior: PosePrior, center: Vector3, length: float
) -> tuple[RigidTransform, ...]:
    """The best distinct poses, as many as are handed on, of those that a prior admits; ``center`` is the target's."""
    moved = poses.carry(center)
    is_admitted = prior.admits(poses.rotations, moved, center, pose_inaccuracy(length))
    scores = np.where(is_admitted, scores, -np.inf)
    keep = distinct_poses(poses.rotations, moved, scores, *same_pose(length), N_CANDIDATES)
    return tuple(poses.pose(k, moved[k], center) for k in keep[np.isfinite(scores[keep])].tolist())


def frame_poses(base: PreparedMap, target: PreparedMap, anchors: Indices, neighbours: Indices) -> CandidatePoses:
    """Poses that map each anchor and its frame onto each of its neighbours (a, k) and their frames."""
    rows, base_rows = np.repeat(np.arange(len(anchors)), neighbours.shape[1]), neighbours.ravel()
    base_frames = point_frames(base.point_field, base.point_gradient)[base_rows]
    target_frames = point_frames(target.point_field, target.point_gradient)[anchors[rows]]
    R: Tensors = base_frames @ np.swapaxes(target_frames, 1, 2)
    return CandidatePoses(R, base.points[base_rows], rows, target.points[anchors])
