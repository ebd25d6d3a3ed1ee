# SPDX-License-Identifier: BSD-3-Clause
"""Search for loop closures: where a window may lie in a submap."""
