# SPDX-License-Identifier: BSD-3-Clause
"""Rigid motions over SciPy's RigidTransform: points, vectors and tensors move differently; and paths.

``T_base_target`` takes target coordinates to base coordinates. Tangent vectors are rotation first.
"""

from functools import reduce

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.typing import Covariance6, Mask, Matrix, Points, Scalars, Tensors, ThirdOrder, Vector3, Vectors

# Relative error that products of small matrices accumulate: less is none but rounding.
ROUNDING = 1e-12
# Largest entry of R R^T - I that a file may hold.
ORTHONORMAL_TOLERANCE = 1e-9
# m: farther from their origin, coordinates lose digits that show. Up to here single precision, in which pictures are
# drawn, keeps 0.1 mm, and a covariance about the origin keeps half the digits of one about the samples.
FAR = 1e3
# rad: equations of a turn that is larger are not linear; no step to a best pose takes more.
LINEAR_TURN = 0.3
# Steps that are looked at together; of every eighth of their samples jitter leaves an eighth of its path, steps at
# random a third, and a path all of it.
STOOD, EIGHTH, STANDS = 128, 8, 0.2
# Pairs of a point and a facet of a hull that are looked at together: bounds memory.
FACETS_AT_ONCE = 2_000_000
# Unit vectors every way along the axes; and to corners, edges and faces of a cube.
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def rotation_matrix(T_base_target: RigidTransform) -> Matrix:
    """``R`` of a transform, (3, 3), or of many. `T.rotation` goes by quaternions: a hundred times as long."""
    return T_base_target.as_matrix()[..., :3, :3]


def transform_points(p_target: Points, T_base_target: RigidTransform) -> Points:
    """Points (n, 3), m, of the target frame in the base frame: ``R p + t``."""
    return np.asarray(p_target @ rotation_matrix(T_base_target).T + T_base_target.translation)


def rotate_vectors(b_target: Vectors, T_base_target: RigidTransform) -> Vectors:
    """Field vectors (n, 3), T, of the target frame in the base frame: ``R b``; the translation does not act."""
    return np.asarray(b_target @ rotation_matrix(T_base_target).T)


def rotate_tensors(G_target: Tensors, T_base_target: RigidTransform) -> Tensors:
    """Field gradients (n, 3, 3), T/m (or Hessians of the magnitude) in the base frame: ``R G R^T``."""
    R = rotation_matrix(T_base_target)
    return np.asarray(R @ G_target @ R.T)


def rotate_third_order(D_target: ThirdOrder, T_base_target: RigidTransform) -> ThirdOrder:
    """Second derivatives (n, 3, 3, 3), T/m^2, in the base frame: ``[i, a, b, c] = d2 B_a / dx_b dx_c``."""
    R = rotation_matrix(T_base_target)
    return np.asarray(np.einsum("ai,bj,ck,nijk->nabc", R, R, R, D_target, optimize=True))


def transform_from_matrix(matrix: np.ndarray) -> RigidTransform:
    """Rigid motion given as a matrix (4, 4) ``[[R, t], [0, 1]]``, t in m, as files hold it; else a ValueError.

    A rotation that is orthonormal to rounding keeps its very bits, so that reading what was written changes
    nothing; one that was written with fewer digits, to 1e-9, is brought to the nearest rotation.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        msg = f"expected a finite 4x4 matrix, got shape {matrix.shape}"
        raise ValueError(msg)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        msg = f"expected the last row of a rigid transform to be 0, 0, 0, 1, got {matrix[3].tolist()}"
        raise ValueError(msg)
    R = matrix[:3, :3]
    # Clipped, so that squares of absurd entries do not overflow.
    error = float(np.abs(np.clip(R, -2, 2) @ np.clip(R, -2, 2).T - np.eye(3)).max())
    if error > ORTHONORMAL_TOLERANCE:
        msg = f"expected a rotation in the upper left 3x3, got one that is off orthonormal by {error:.1e}"
        raise ValueError(msg)
    if np.linalg.det(R) < 0:
        msg = "expected a rotation in the upper left 3x3, got a reflection (determinant -1)"
        raise ValueError(msg)
    return RigidTransform(matrix, normalize=error > ROUNDING)


def transform_of(R: Matrix, p: Vector3) -> RigidTransform:
    """Rigid motion that turns by R, which is taken for a rotation, and then shifts by p (m)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, p
    return RigidTransform(matrix, normalize=False)


def transform_from_product(matrix: Matrix) -> RigidTransform:
    """Rigid motion whose matrix is a product of such matrices: brought to the nearest once rounding has added up.

    Of many, (n, 4, 4), all are.
    """
    R = matrix[..., :3, :3]
    error = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
    return RigidTransform(matrix, normalize=bool(error > ROUNDING))


def product(*transforms: RigidTransform) -> RigidTransform:
    """Product of transforms by their matrices: ``A * B`` goes by quaternions, which takes half a millisecond."""
    return transform_from_product(reduce(np.matmul, [T.as_matrix() for T in transforms]))


def unit_vectors(vectors: Vectors) -> Vectors:
    """Vectors (n, 3) of length 1, in the same directions; where one has no length, 0."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), np.finfo(float).tiny)[:, None])


def skew(v: Points) -> Tensors:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3): ``skew(a) @ b == a x b``."""
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return S - np.swapaxes(S, -1, -2)


# Turns about x, y and z, per rad.
GENERATORS = skew(np.eye(3))


def turn_and_shift(T: RigidTransform) -> np.ndarray:
    """Rotation vector (rad) and translation (m) of one transform or many, (6,) or (n, 6): if small, the logarithm."""
    turn = Rotation.from_matrix(rotation_matrix(T), assume_valid=True).as_rotvec()
    return np.concatenate([turn, T.translation], axis=-1)


def adjoint(T: RigidTransform) -> Matrix:
    """Takes xi of one frame to that of another, rotation first: ``T Exp(xi) T^-1 = Exp(Ad xi)``; (6, 6)."""
    R, M = rotation_matrix(T), np.zeros((6, 6))
    M[:3, :3] = M[3:, 3:] = R
    M[3:, :3] = skew(np.asarray(T.translation)[None])[0] @ R
    return M


def covariance_about(covariance: Covariance6, point: Vector3) -> Covariance6:
    """A covariance of xi about a frame's origin as one about a point of the frame, same axes."""
    if not np.any(point):
        return covariance
    M = adjoint(RigidTransform.from_translation(-point))
    moved = np.asarray(M @ covariance @ M.T)
    # About an origin at 5,000 km, a turn by 0.1 deg is a shift of km: what that rounds off may be all that is left.
    rounding, lowest = np.finfo(float).eps * np.trace(covariance[3:, 3:]), np.linalg.eigvalsh(moved)[0]
    if lowest < rounding:
        moved = (moved + moved.T) / 2 + np.diag([0.0] * 3 + [rounding - lowest] * 3)
    return moved


def near_origin(points: Points, step: float) -> Vector3:
    """A point to take off coordinates, in whole steps (m): zero where all lie within `FAR` of the origin."""
    if not len(points) or np.abs(points).max() <= FAR:
        return np.zeros(3)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return np.asarray(step * np.trunc(middle / step))


def perturbation(xi: np.ndarray, center: Vector3) -> RigidTransform:
    """Small motion about a centre: turn by ``xi[:3]`` (rad) about it, then shift by ``xi[3:]`` (m)."""
    R = Rotation.from_rotvec(xi[:3]).as_matrix()
    return transform_of(R, center + xi[3:] - R @ center)


def perturbation_between(T: RigidTransform, T_moved: RigidTransform, center: Vector3) -> np.ndarray:
    """The xi of ``T_moved = T perturbation(xi, center)``: rotation first (rad, m)."""
    moved = T.inv() * T_moved
    return np.concatenate([moved.rotation.as_rotvec(), moved.apply(center) - center])


def random_transform(rng: np.random.Generator, max_translation: float = 5.0) -> RigidTransform:
    """Uniformly random rotation, and a translation uniform in a cube of twice ``max_translation`` (m)."""
    rotation = Rotation.random(rng=rng)
    return RigidTransform.from_components(rng.uniform(-max_translation, max_translation, 3), rotation)


def transform_error(T_estimate: RigidTransform, T_true: RigidTransform, center: Vector3) -> tuple[float, float]:
    """How far two transforms of the same frames differ: ``|T_estimate c - T_true c|``, m, and the angle between, rad.

    The centre (3,), m, is that of the target's samples, target frame.
    """
    return _shift_between(T_estimate, T_true, center), _turn_between(T_estimate, T_true)


def is_one_pose(T: RigidTransform, T_other: RigidTransform, center: Vector3, tolerance: tuple[float, float]) -> bool:
    """Whether two transforms of the same frames differ by no more than a tolerance (m, rad), as `transform_error`."""
    return _shift_between(T, T_other, center) <= tolerance[0] and _turn_between(T, T_other) <= tolerance[1]


def _shift_between(T: RigidTransform, T_other: RigidTransform, center: Vector3) -> float:
    off = (rotation_matrix(T) - rotation_matrix(T_other)) @ center + T.translation - T_other.translation
    return float(np.linalg.norm(off))


def _turn_between(T: RigidTransform, T_other: RigidTransform) -> float:
    between = rotation_matrix(T).T @ rotation_matrix(T_other)
    return float(Rotation.from_matrix(between, assume_valid=True).magnitude())


def path_walked(positions: Points) -> Scalars:
    """Path walked up to each of consecutive positions: (n,), m, from 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def typical_step(steps: Scalars) -> float:
    """Median of the steps (m) between consecutive samples: further readings at one place are none."""
    walked = steps[steps > 0]
    return float(np.median(walked)) if len(walked) else 0.0


def path_moved(positions: Points) -> Scalars:
    """Give the length of the path, without what jitter adds where somebody stands: (n,), m."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    for first in range(0, len(steps), STOOD):
        begin = max(min(first, len(steps) - STOOD), 0)
        some = positions[begin : begin + STOOD + 1]
        if path_walked(some[::EIGHTH])[-1] <= STANDS * path_walked(some)[-1]:
            steps[first : first + STOOD] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])


def in_hull(points: Matrix, samples: Matrix) -> Mask:
    """Whether points (n, d) lie within the convex hull of samples (m, d), d 2 or 3, to rounding.

    None do where the samples have no hull: on a line, in three dimensions on a plane.
    """
    try:
        facets = ConvexHull(samples).equations
    except QhullError:
        return np.zeros(len(points), dtype=np.bool_)
    slack = 1e-9 * float(np.ptp(samples, axis=0).max())
    inside = np.ones(len(points), dtype=np.bool_)
    step = FACETS_AT_ONCE // len(facets) + 1
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        inside[part] = np.all(points[part] @ facets[:, :-1].T + facets[:, -1] <= slack, axis=1)
    return inside


def principal_frame(positions: Points, lean: Vector3) -> RigidTransform:
    """Frame at the points' centroid along their principal axes, longest first: takes its coordinates to theirs.

    Axes are signed by the skewness of the points along them, by ``lean`` where that vanishes.
    """
    centroid = positions.mean(axis=0)
    offset = positions - centroid
    _, axes = np.linalg.eigh(offset.T @ offset / len(offset))
    R = axes[:, ::-1].copy()
    along = offset @ R
    skewness = (along**3).mean(axis=0)
    spread = (along**2).mean(axis=0) ** 1.5
    is_skewed = np.abs(skewness) > 1e-6 * np.maximum(spread, np.finfo(float).tiny)
    R *= np.where(np.where(is_skewed, skewness, lean @ R) < 0, -1.0, 1.0)
    R[:, 2] = np.cross(R[:, 0], R[:, 1])
    return transform_of(R, centroid)
