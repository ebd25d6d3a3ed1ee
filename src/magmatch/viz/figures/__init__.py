# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the nouns, and what is computed for them alone."""
