# SPDX-License-Identifier: BSD-3-Clause
"""The live door: samples in, poses out, for many bodies at once; no arithmetic of its own."""
