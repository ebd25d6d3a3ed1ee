# SPDX-License-Identifier: BSD-3-Clause
"""The last look: each window on one map of its log's passes beside it, now that their places are known."""
