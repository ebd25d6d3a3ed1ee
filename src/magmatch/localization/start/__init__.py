# SPDX-License-Identifier: BSD-3-Clause
"""Where a body may have started: all places and headings scored, the best refined."""
