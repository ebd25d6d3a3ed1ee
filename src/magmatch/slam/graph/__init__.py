# SPDX-License-Identifier: BSD-3-Clause
"""Poses of windows, and what ties them."""
