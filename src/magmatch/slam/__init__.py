# SPDX-License-Identifier: BSD-3-Clause
"""Logs whose poses drift, corrected and in one frame: stretches of path that pass one place are found and tied."""
