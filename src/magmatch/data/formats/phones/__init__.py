# SPDX-License-Identifier: BSD-3-Clause
"""Logs of phones: each app's layout becomes one `PhoneLog`."""
