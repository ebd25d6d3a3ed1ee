# SPDX-License-Identifier: BSD-3-Clause
"""The published method: keypoints, HOV, MSAC and the fitness check."""
