# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark: named experiments, methods under one protocol, rows that survive a crash, one table, one report."""
