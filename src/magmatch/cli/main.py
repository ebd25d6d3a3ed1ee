# SPDX-License-Identifier: BSD-3-Clause
"""Entry point: known errors become one line on stderr and exit code 2, others exit code 1."""


def main() -> None:
    """Run the command line."""
    raise SystemExit(2)
