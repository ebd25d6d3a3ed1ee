# SPDX-License-Identifier: BSD-3-Clause
"""All of a log says where a body was: both directions are compared, believed as far as they agree, and fused."""
