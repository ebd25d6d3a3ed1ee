# SPDX-License-Identifier: BSD-3-Clause
"""What a session leaves in a folder."""
