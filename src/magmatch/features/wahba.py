# SPDX-License-Identifier: BSD-3-Clause
"""The rotations that turn directions onto others best: Wahba's problem, by Davenport's q-method.

The quaternion sought is the eigenvector of the largest eigenvalue of a symmetric matrix (4, 4).

Davenport, P. (1968): A vector approach to the algebra of rotations with applications, NASA TN D-4696.
"""

import numpy as np

from magmatch.compiled import allocating, compiled
from magmatch.typing import Matrix, Scalars, Tensors, Vectors

# Sweeps of Jacobi's method over all pairs of axes, at most: each squares what is left off the diagonal.
SWEEPS = 8


@allocating
def best_rotations(base: tuple[Vectors, ...], target: tuple[Vectors, ...], weights: tuple[Scalars, ...]) -> Tensors:
    """Rotations R (n, 3, 3) that maximise the weighted sum of ``a . R b`` over the directions a, b of some vectors.

    Vectors (n, 3) of any length; any rotation that does as well where they leave a choice.
    """
    found, K, V = np.empty((len(weights[0]), 3, 3)), np.empty((4, 4)), np.empty((4, 4))
    for n in range(len(found)):
        H = found[n]  # first the attitude profile, the sum of a b^T, then R
        H[:] = 0.0
        for m in range(len(weights)):
            a, b = base[m][n], target[m][n]
            lengths = np.sqrt((a[0] ** 2 + a[1] ** 2 + a[2] ** 2) * (b[0] ** 2 + b[1] ** 2 + b[2] ** 2))
            if lengths > 0.0:
                for i in range(3):
                    for j in range(3):
                        H[i, j] += weights[m][n] / lengths * a[i] * b[j]
        to_rotation(H, K, V)
    return found


@compiled
def to_rotation(H: Matrix, K: Matrix, V: Matrix) -> None:
    """Overwrite H (3, 3) by the rotation R nearest to it: with most trace of ``R^T H``. K, V (4, 4) are used up."""
    trace = H[0, 0] + H[1, 1] + H[2, 2]
    for i in range(3):
        for j in range(3):
            K[i, j] = H[i, j] + H[j, i]
        K[i, i] -= trace
        j, k = (i + 1) % 3, (i + 2) % 3
        K[i, 3] = K[3, i] = H[k, j] - H[j, k]
    K[3, 3] = trace
    _diagonalise(K, V)
    k = 0
    for i in range(1, 4):
        if K[i, i] > K[k, k]:
            k = i
    w = V[3, k]
    for i in range(3):
        for j in range(3):
            H[i, j] = 2 * V[i, k] * V[j, k]
        H[i, i] += 2 * w * w - 1
    for i in range(3):
        j = (i + 1) % 3
        turn = 2 * w * V[(i + 2) % 3, k]
        H[j, i] += turn
        H[i, j] -= turn


@compiled
def _diagonalise(K: Matrix, V: Matrix) -> None:
    """Eigenvalues of a symmetric matrix (4, 4), left on its diagonal, and its eigenvectors, columns of V."""
    for i in range(4):
        for j in range(4):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        left = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                left += abs(K[p, q])
                if K[p, q] == 0.0:
                    continue
                # Tangent of the smaller of the two angles that make this entry 0 (Golub and Van Loan, section 8.5).
                half = (K[q, q] - K[p, p]) / (2 * K[p, q])
                t = 1 / (abs(half) + np.sqrt(half * half + 1))
                c = 1 / np.sqrt(t * t + 1)
                s = t * c if half >= 0 else -t * c
                for i in range(4):
                    K[i, p], K[i, q] = c * K[i, p] - s * K[i, q], s * K[i, p] + c * K[i, q]
                for i in range(4):
                    K[p, i], K[q, i] = c * K[p, i] - s * K[q, i], s * K[p, i] + c * K[q, i]
                    V[i, p], V[i, q] = c * V[i, p] - s * V[i, q], s * V[i, p] + c * V[i, q]
                K[p, q] = K[q, p] = 0.0
        if left == 0.0:
            break
