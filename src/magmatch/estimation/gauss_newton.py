# SPDX-License-Identifier: BSD-3-Clause
"""Gauss-Newton steps of poses: how far one goes, what it moves, when they end, and how little outliers weigh."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.typing import Matrix, Points, Scalars, Tensors

# Steps end when one moves the estimate by less than this many of its standard deviations.
CLOSE = 0.1
# Degrees of freedom of the Student-t model of residuals: outliers lose weight, inliers keep it.
STUDENT_DOF = 4.0


def shortened(xi: np.ndarray, longest: np.ndarray) -> np.ndarray:
    """Shorten steps (..., n) as a whole, so that no entry exceeds its longest: beyond, equations are not linear.

    ``longest`` (k,) is of the first k entries, turn and shift; the others may be of any size.
    """
    excess = np.abs(xi[..., : len(longest)] / longest).max(axis=-1, keepdims=True)
    return np.asarray(xi / np.maximum(1.0, excess))


def is_close(xi: np.ndarray, information: Matrix) -> bool:
    """Whether a step is so short beside the estimate's uncertainty that no further one is worth its cost."""
    return float(xi @ information @ xi) < CLOSE**2


def perturbed(R: Tensors, p: Points, xi: Matrix) -> tuple[Tensors, Points]:
    """Perturb poses ``T Exp(xi)`` about a centre: rotations (h, 3, 3), and where they put the centre, (h, 3), m."""
    return R @ Rotation.from_rotvec(xi[:, :3]).as_matrix(), p + np.einsum("hij,hj->hi", R, xi[:, 3:])


def student_weights(chi2: Scalars, n_components: int) -> Scalars:
    """Weights of residual vectors by their squared norms, in variances of a component."""
    return np.asarray((STUDENT_DOF + n_components) / (STUDENT_DOF + chi2))
