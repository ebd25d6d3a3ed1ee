# SPDX-License-Identifier: BSD-3-Clause
"""Evidence for a pose against the null model, and its covariance."""
