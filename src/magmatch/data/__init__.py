# SPDX-License-Identifier: BSD-3-Clause
"""Surveys and trajectories: the nouns, one reader per format, checks and public recordings."""
