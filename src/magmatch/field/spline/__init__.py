# SPDX-License-Identifier: BSD-3-Clause
"""The spline model of a magnetic potential."""
