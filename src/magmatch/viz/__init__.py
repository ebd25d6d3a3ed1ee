# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of surveys, maps and registrations; draws the nouns, computes nothing."""
