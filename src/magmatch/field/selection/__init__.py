# SPDX-License-Identifier: BSD-3-Clause
"""Hyperparameters and outliers, determined from data before the fit."""
