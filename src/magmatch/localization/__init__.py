# SPDX-License-Identifier: BSD-3-Clause
"""Where a body is in a known map, sample by sample, from an unknown start."""
