# SPDX-License-Identifier: BSD-3-Clause
"""Registration needs this of one base map, computed once and stored next to it."""
