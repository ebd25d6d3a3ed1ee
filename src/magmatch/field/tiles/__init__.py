# SPDX-License-Identifier: BSD-3-Clause
"""Large regions: one factorisation per tile."""
