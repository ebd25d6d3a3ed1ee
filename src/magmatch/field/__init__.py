# SPDX-License-Identifier: BSD-3-Clause
"""The magnetic field of a place, inferred from samples by a linear basis with a Gaussian prior."""
