# SPDX-License-Identifier: BSD-3-Clause
"""A writer that is killed leaves the old file or the new one, whole. `make harden` kills many."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import magmatch

SCRIPT = Path(__file__).with_name("writers.py")
SOURCE = Path(magmatch.__file__).parent
# What writes files that other processes or users read, and is not in the catalogue: why.
ELSEWHERE = {
    "atomic.py": "the function itself",
    "data/datasets.py": "a cache, checked by SHA-256 whenever it is used",
    "viz/rerun_recording.py": "a picture; its bytes differ each time",
    "simulation/write_pair.py": "made again from a seed; the truth is written last",
}
IN_CATALOGUE = {
    "data/document.py", "data/logs/write_mcap.py", "data/formats/parquet.py", "data/tables/table.py",
    "data/tables/tum.py", "data/write.py", "store.py", "field/axis_grid.py", "registration/g2o.py",
    "registration/to_other_programs.py", "viz/pages/page.py",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills with a POSIX signal")
def test_a_killed_writer_leaves_one_whole_file(n_kills, tmp_path):
    path = os.pathsep.join([str(SOURCE.parent), os.environ.get("PYTHONPATH", "")])
    made = subprocess.run(
        [sys.executable, "-W", "ignore", SCRIPT, tmp_path / "files", str(n_kills)],
        capture_output=True, check=False, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    assert made.returncode == 0, made.stderr.decode()[-2000:]
    rows = [json.loads(line) for line in made.stdout.splitlines()]
    print(*rows, sep="\n")
    assert sum(row["kills"] for row in rows) == n_kills
    assert sum(row["neither"] for row in rows) == 0
    assert n_kills < 100 or sum(row["in_the_middle"] for row in rows) > n_kills / 10  # else nothing was shown


def test_every_file_is_written_by_a_writer_that_is_killed_here():
    """A new writer belongs into the catalogue of `writers.py`, and its module into the set above."""
    users = {
        str(path.relative_to(SOURCE)).replace(os.sep, "/")
        for path in SOURCE.rglob("*.py")
        if "atomic_write(" in path.read_text(encoding="utf-8")
    }
    assert users == IN_CATALOGUE | ELSEWHERE.keys()


def test_nothing_else_opens_files_for_writing():
    marks = ('open("w', 'open("x', 'open("a', "write_text(", "write_bytes(")
    users = {
        str(path.relative_to(SOURCE)).replace(os.sep, "/")
        for path in SOURCE.rglob("*.py")
        if any(mark in path.read_text(encoding="utf-8") for mark in marks)
    }
    # Unpacked tables, and what came through a pipe, are passing copies in a folder of their own.
    assert users == {"atomic.py", "data/tables/gzipped.py", "data/tables/pipes.py"}
