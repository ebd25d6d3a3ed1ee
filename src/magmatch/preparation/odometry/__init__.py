# SPDX-License-Identifier: BSD-3-Clause
"""Dead reckoning on foot: poses for logs of phones that have none."""
