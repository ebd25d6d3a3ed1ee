# SPDX-License-Identifier: BSD-3-Clause
"""Where a body was, by all of a log: both directions compared, believed as far as they agree, and fused."""
