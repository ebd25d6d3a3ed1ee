# SPDX-License-Identifier: BSD-3-Clause
"""Processes that follow bodies, each for its clients, and what they keep of them."""
