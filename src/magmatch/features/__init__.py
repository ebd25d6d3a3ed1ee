# SPDX-License-Identifier: BSD-3-Clause
"""Keypoints of a map: where they are, their local frames, their descriptors."""
