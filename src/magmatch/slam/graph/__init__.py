# SPDX-License-Identifier: BSD-3-Clause
"""The pose graph: poses of windows and the factors between them."""
