# SPDX-License-Identifier: BSD-3-Clause
"""What keeps the first answer on a machine from waiting for the compiler."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import magmatch

SOURCE = Path(magmatch.__file__).parent
# Prints each loop that was compiled for more than one set of types, after one registration of each kind.
COUNT_SIGNATURES = """
import gc
from importlib.resources import as_file, files
from numba.core.dispatcher import Dispatcher
import magmatch as mm
from magmatch.registration.config import PRESETS, RegistrationConfig

with as_file(files("magmatch.data") / "samples" / "office") as folder:
    base, target = (mm.read_survey(folder / f"{name}.csv").subset(range(600)) for name in ("base", "target"))
for settings in (PRESETS["default"], PRESETS["paper"], RegistrationConfig(search="pairs")):
    mm.register(base, target, settings)
loops = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.py_func.__module__.startswith("magmatch.")]
print(sum(len(loop.signatures) > 0 for loop in loops))
for loop in loops:
    if len(loop.signatures) > 1:
        print(loop.py_func.__module__, loop.py_func.__name__, loop.signatures)
"""
# Says on stderr what the command line says, where nothing is in the cache.
REGISTER = "import sys; from magmatch.cli.main import main; sys.exit(main(sys.argv[1:]))"


# Compiles a loop twice, as two runs would, with what the first argument does to numba's cache in between.
COMPILE = """
import logging, sys
from numba.core import caching
logging.basicConfig(level=0, format="%(message)s", stream=sys.stdout)
logging.getLogger("numba").setLevel(logging.WARNING)

def nowhere(*_):
    raise OSError(30, "Read-only file system")

{before}
from magmatch import compiled

def double(x):
    return 2 * x

double.__module__ = "magmatch.double"
for _ in range(2):
    loop = compiled.compiled(double)
    assert loop(21) == 42
    {between}
"""
OBSTACLES = {
    "no folder can be written": (
        "caching._SourceFileBackedLocatorMixin.ensure_cache_path = caching._CacheLocator.ensure_cache_path = nowhere",
        "pass",
        "in every run, since neither the package's folder nor the user's cache can be written; NUMBA_CACHE_DIR names",
    ),
    "the disk is full": (
        "caching.IndexDataCacheFile._save_data = nowhere",
        "pass",
        "cannot be written ([Errno 30] Read-only file system); NUMBA_CACHE_DIR names",
    ),
    "what is kept is damaged": (
        "",
        "[p.write_bytes(b'?') for p in __import__('pathlib').Path(loop._cache.cache_path).glob('*.nbi')]",
        "once per kind of task",
    ),
    "what is kept is of another": ("", "caching.IndexDataCacheFile._load_index = nowhere", "are not kept"),
}


@pytest.mark.parametrize("case", OBSTACLES)
def test_loops_that_cannot_be_kept_are_compiled_each_time_with_one_word(case, tmp_path):
    before, between, said = OBSTACLES[case]
    (tmp_path / "run.py").write_text(COMPILE.format(before=before, between=between))
    place = {} if before.startswith("caching._Source") else {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    source = os.pathsep.join([str(SOURCE.parent), os.environ.get("PYTHONPATH", "")])
    plain = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, tmp_path / "run.py"], capture_output=True, text=True, check=False,
        env=plain | {"PYTHONPATH": source} | place,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    assert done.stdout.count("NUMBA_CACHE_DIR") == ("once" not in said)


@pytest.mark.slow
def test_registrations_of_each_kind_compile_every_loop_for_one_set_of_types():
    done = subprocess.run([sys.executable, "-c", COUNT_SIGNATURES], capture_output=True, text=True, check=True)
    n_loops, *more = done.stdout.splitlines()
    assert int(n_loops) > 15
    assert not more


@pytest.mark.slow
def test_the_first_use_says_that_it_compiles_and_a_later_one_says_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    rows = (SOURCE / "data" / "samples" / "office" / "base.csv").read_text().splitlines(keepends=True)
    (tmp_path / "few.csv").write_text("".join(rows[:60]))
    words = [sys.executable, "-c", REGISTER, "map", str(tmp_path / "few.csv"), "--prior", "spline", "--out"]
    first, later = (
        subprocess.run([*words, str(tmp_path / name)], capture_output=True, text=True, check=True).stderr
        for name in ("a.map", "b.map")
    )
    assert first.count("Compiling numerical loops") == 1
    assert "Compiling" not in later
