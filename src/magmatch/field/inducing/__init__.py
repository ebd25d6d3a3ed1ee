# SPDX-License-Identifier: BSD-3-Clause
"""Gaussian processes on inducing points."""
