# SPDX-License-Identifier: BSD-3-Clause
"""Readers, one per format, and the test which format a file is."""
