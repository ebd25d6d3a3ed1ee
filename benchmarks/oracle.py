# SPDX-License-Identifier: BSD-3-Clause
"""The oracles of the tests, which some scripts compare with."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from oracles.dense import DenseGP
from oracles.recursive import RecursiveSparseGP

__all__ = ["DenseGP", "RecursiveSparseGP"]
