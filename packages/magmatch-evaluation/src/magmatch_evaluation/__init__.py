# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark of magmatch: named experiments, methods under one protocol, rows that survive a crash, one report."""
