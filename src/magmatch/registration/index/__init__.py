# SPDX-License-Identifier: BSD-3-Clause
"""What registration needs of one base map, computed once and stored next to it."""
