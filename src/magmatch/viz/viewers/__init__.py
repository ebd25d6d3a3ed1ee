# SPDX-License-Identifier: BSD-3-Clause
"""Three-dimensional viewers, in the browser and in Rerun."""
