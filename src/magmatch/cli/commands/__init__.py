# SPDX-License-Identifier: BSD-3-Clause
"""One file per subcommand: each parses, calls one verb, saves and reports."""
