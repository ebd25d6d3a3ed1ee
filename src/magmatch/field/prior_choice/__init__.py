# SPDX-License-Identifier: BSD-3-Clause
"""Which prior a map takes, with which numbers."""
