# SPDX-License-Identifier: BSD-3-Clause
"""A body is found in a known map, sample by sample, from an unknown start."""
