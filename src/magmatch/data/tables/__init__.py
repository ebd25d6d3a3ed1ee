# SPDX-License-Identifier: BSD-3-Clause
"""Cells, rows and words of text files."""
