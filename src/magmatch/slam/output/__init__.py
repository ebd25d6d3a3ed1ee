# SPDX-License-Identifier: BSD-3-Clause
"""A session leaves files in a folder."""
