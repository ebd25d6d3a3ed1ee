# SPDX-License-Identifier: BSD-3-Clause
"""Sparse Cholesky factorisation on grids; independent of magnetism."""
