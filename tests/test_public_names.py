# SPDX-License-Identifier: BSD-3-Clause
"""Names that pages and examples show are public: in `magmatch` or in one of its public submodules."""

import importlib
import json
import pkgutil
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

import magmatch as mm

ROOT = Path(__file__).parents[1]
PUBLIC = ("magmatch", "magmatch.phones", "magmatch.published", "magmatch.simulation", "magmatch.viz")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "examples").glob("*"))]
# Groups of entry points and schemas of files, which are no names of Python.
OTHER = re.compile(r"magmatch\.commands\b|magmatch\.[a-z.]+/|magmatch\.survey_frame")
IMPORT = re.compile(r"from (magmatch[\w.]*) import \(?([\w, ]+)|import (magmatch[\w.]*)")
DOTTED = re.compile(r"(?<![\w./\"-])(?:mm|magmatch)((?:\.[A-Za-z_]\w*)+)")


def members(module):
    return set(importlib.import_module(module).__all__)


def text_of(path):
    if path.suffix != ".ipynb":
        return path.read_text(encoding="utf-8")
    return "\n".join("".join(cell["source"]) for cell in json.loads(path.read_text())["cells"])


def is_public(name):
    """Whether a dotted name begins with a public one, whatever is asked of that."""
    for module in sorted(PUBLIC, key=len, reverse=True):
        if name == module:
            return True
        if name.startswith(f"{module}."):
            return name.removeprefix(f"{module}.").partition(".")[0] in members(module)
    return False


@pytest.mark.parametrize("page", [p for p in PAGES if p.is_file()], ids=lambda page: page.name)
def test_names_on_a_page_are_public(page):
    text = OTHER.sub("", text_of(page))
    directives = re.findall(r"^::: (\S+)", text, re.MULTILINE)
    for name in directives:
        thing = pkgutil.resolve_name(name)
        # A room that has the name of its verb hides that from the page's builder: there it is named by its home.
        assert is_public(name) or any(
            getattr(importlib.import_module(m), name.rpartition(".")[2], None) is thing for m in PUBLIC
        ), name
        assert not isinstance(thing, types.ModuleType) or name in directives, name
    text = re.sub(r"^::: \S+|\(#magmatch\.[\w.]+\)", "", text, flags=re.MULTILINE)
    for module, names, plain in IMPORT.findall(text):
        assert (module or plain) in PUBLIC, module or plain
        for name in filter(None, (part.split(" as ")[0].strip() for part in names.split(","))):
            assert is_public(f"{module}.{name}"), (module, name)
    for rest in DOTTED.findall(IMPORT.sub("", text)):
        assert is_public(f"magmatch{rest}"), f"magmatch{rest}"


def test_dir_is_the_public_names():
    assert dir(mm) == sorted(mm.__all__)
    assert {"PRESETS", "MapIndex", "Hyperparameters", "SurveyError", "MagmatchError"} <= set(dir(mm))
    for name in dir(mm):
        assert getattr(mm, name) is not None


def test_public_rooms_are_there_without_an_import_of_their_own():
    code = "import magmatch as mm; print(mm.published, mm.simulation, mm.viz, mm.phones)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_importing_loads_nothing_heavy():
    code = "import sys, magmatch; dir(magmatch); magmatch.SurveyError; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "numba", "pandas", "xarray", "plotly", "pydantic"} & set(loaded)
