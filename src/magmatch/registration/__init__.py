# SPDX-License-Identifier: BSD-3-Clause
"""Two maps in, one transform out: search, refine, decide."""
