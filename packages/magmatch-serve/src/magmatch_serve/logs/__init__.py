# SPDX-License-Identifier: BSD-3-Clause
"""Whole logs: how they come in, and what worker processes do with them."""
