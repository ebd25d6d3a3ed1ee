# SPDX-License-Identifier: BSD-3-Clause
"""Self-contained HTML pages of registrations, maps and surveys."""
