# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of surveys, maps and results; computes nothing itself. Needs the extra 'viz'."""
