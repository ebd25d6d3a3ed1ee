# SPDX-License-Identifier: BSD-3-Clause
"""Maps that grow sample by sample."""
