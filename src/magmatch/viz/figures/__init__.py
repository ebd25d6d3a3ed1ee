# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of surveys, maps and results, and what is computed only for them."""
