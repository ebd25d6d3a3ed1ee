# SPDX-License-Identifier: BSD-3-Clause
"""``python -m magmatch``: the same program as ``magmatch``."""

import sys

from magmatch.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
