# SPDX-License-Identifier: BSD-3-Clause
"""Maps on the disk, and for other programs."""
