# SPDX-License-Identifier: BSD-3-Clause
"""Refinement of a candidate against the field, with estimated differences between the surveys."""
