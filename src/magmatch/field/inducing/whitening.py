# SPDX-License-Identifier: BSD-3-Clause
"""Cholesky factor of the inducing points' covariance: what turns weights into ones with prior N(0, I)."""

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from magmatch.typing import Matrix


def gram_factor(gram: Matrix, jitter: float) -> Matrix:
    """Lower Cholesky factor of a Gram matrix of inducing points."""
    largest = float(gram.diagonal().max(initial=0.0))
    gram[np.diag_indices_from(gram)] += jitter * largest
    try:
        return np.asfortranarray(cholesky(gram, lower=True, check_finite=False))
    except LinAlgError as error:
        smallest = float(np.linalg.eigvalsh(gram / largest)[0])
        msg = (
            f"the covariance of {len(gram)} inducing values is not positive definite ({error}; smallest eigenvalue "
            f"{smallest:.1e} of the variance): inducing points coincide or are too dense for jitter {jitter:.1e}"
        )
        raise ValueError(msg) from error
