# SPDX-License-Identifier: BSD-3-Clause
"""Many maps, each in its own frame: which one holds a survey, and where in it."""
