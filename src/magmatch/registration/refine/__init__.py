# SPDX-License-Identifier: BSD-3-Clause
"""A candidate, refined against the field, with what may differ between the surveys."""
