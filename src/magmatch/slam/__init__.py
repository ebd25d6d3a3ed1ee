# SPDX-License-Identifier: BSD-3-Clause
"""Logs whose poses drift, corrected and in one frame: loop closures between windows of path at the same place."""
