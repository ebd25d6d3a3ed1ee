# SPDX-License-Identifier: BSD-3-Clause
"""The command line: one file per subcommand, each parses, calls one verb, saves and reports."""
