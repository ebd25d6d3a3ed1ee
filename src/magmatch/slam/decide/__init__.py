# SPDX-License-Identifier: BSD-3-Clause
"""Decision on loop closures: which of the places where the windows of a log may lie are believed."""
