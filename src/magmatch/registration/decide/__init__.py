# SPDX-License-Identifier: BSD-3-Clause
"""The decision to accept or refuse a pose, and the statement of the result."""
