# SPDX-License-Identifier: BSD-3-Clause
"""Scripts that print figures can be run with the package as it is."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("script", sorted(BENCHMARKS.rglob("*.py")), ids=lambda path: path.stem)
def test_a_script_finds_all_that_it_imports(script, monkeypatch):
    for folder in (script.parent, BENCHMARKS / "experiments"):
        monkeypatch.syspath_prepend(folder)
    spec = spec_from_file_location(f"script_{script.stem}", script)
    module = module_from_spec(spec)
    # Its dataclasses look themselves up.
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    assert module.__doc__
