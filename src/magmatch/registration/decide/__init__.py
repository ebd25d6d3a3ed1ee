# SPDX-License-Identifier: BSD-3-Clause
"""Accept or refuse, and state the result."""
