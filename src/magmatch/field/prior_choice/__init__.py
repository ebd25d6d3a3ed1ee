# SPDX-License-Identifier: BSD-3-Clause
"""The choice of a map's prior and hyperparameters."""
