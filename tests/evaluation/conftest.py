# SPDX-License-Identifier: BSD-3-Clause
"""The toy evaluation, as a module of its own so that a process can run it too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
