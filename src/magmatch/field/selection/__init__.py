# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters and outliers: what is chosen from data before the fit."""
