# SPDX-License-Identifier: BSD-3-Clause
"""The commands that this distribution adds to the program."""
