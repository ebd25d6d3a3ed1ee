# SPDX-License-Identifier: BSD-3-Clause
"""The version, on the ground floor: every room may state it."""

__version__ = "0.1.0"
