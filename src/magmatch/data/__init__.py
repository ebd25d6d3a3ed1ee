# SPDX-License-Identifier: BSD-3-Clause
"""Surveys and trajectories, one reader per format, checks, and public recordings."""
