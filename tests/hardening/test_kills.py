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
