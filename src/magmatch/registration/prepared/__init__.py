# SPDX-License-Identifier: BSD-3-Clause
"""The two sides of a comparison as registration sees them."""
