# SPDX-License-Identifier: BSD-3-Clause
"""How often to kill and to corrupt, and the catalogue of all writers."""

import sys
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).with_name("writers.py")
NAMES = [
    "survey .csv", "survey .parquet", "survey .mcap", "survey .tum", "survey .ply", "survey .vtk", "trajectory",
    "query", "map", "map grid .vtk", "map grid .ply", "map grid .nc",
    "result", "result .tum", "result .g2o", "result .yaml", "preparation report", "report page",
    "view page",
]  # fmt: skip


@cache
def loaded() -> ModuleType:
    """The script beside this file as a module; tests are no package to import from."""
    spec = spec_from_file_location("writers", SCRIPT)
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def writers():
    """All writers whose extras are installed, by name."""
    found = loaded().catalogue()
    loaded().pack_once()
    assert list(found) == NAMES
    return found


@pytest.fixture(params=NAMES)
def writer(request, writers):
    """One writer after the other."""
    chosen = writers[request.param]
    if chosen.needs:
        pytest.importorskip(chosen.needs)
    return chosen


@pytest.fixture
def n_kills(request):
    return int(request.config.getoption("--kills"))


@pytest.fixture
def n_corruptions(request):
    return int(request.config.getoption("--corruptions"))
