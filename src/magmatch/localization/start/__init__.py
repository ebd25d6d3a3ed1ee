# SPDX-License-Identifier: BSD-3-Clause
"""A body may have started anywhere: all places and headings are scored, and the best refined."""
