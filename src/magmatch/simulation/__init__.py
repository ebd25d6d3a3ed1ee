# SPDX-License-Identifier: BSD-3-Clause
"""Surveys of known places with exact ground truth."""
