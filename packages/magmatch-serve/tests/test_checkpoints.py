# SPDX-License-Identifier: BSD-3-Clause
"""Clients' states are whole whatever ends their writing. `make harden` kills many writers."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import magmatch_serve
from magmatch_serve.bodies import checkpoints

SOURCE = Path(magmatch_serve.__file__).parent
# Kills are of processes that did nothing else before, so they are forked from another one than this.
KILLS = """
import json, random, sys
from pathlib import Path
from hardening.writers import Writer, kill_while_writing
from magmatch_serve.bodies import checkpoints

writer = Writer(lambda k, path: checkpoints.save(path, bytes([k]) * 200_000), "0a.state")
print(json.dumps(kill_while_writing(writer, Path(sys.argv[1]), int(sys.argv[2]), random.Random(0))))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills with a POSIX signal")
def test_a_killed_service_leaves_a_whole_state(request, tmp_path):
    n_kills = int(request.config.getoption("--kills", 20))
    path = os.pathsep.join([*sys.path, os.environ.get("PYTHONPATH", "")])
    made = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", KILLS, tmp_path / "states", str(n_kills)],
        capture_output=True, check=False, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    assert made.returncode == 0, made.stderr.decode()[-2000:]
    seen = json.loads(made.stdout)
    assert (seen["kills"], seen["neither"]) == (n_kills, 0)


def test_a_full_disk_leaves_the_state_before(tmp_path, monkeypatch):
    path = checkpoints.path_of(tmp_path, "0a")
    checkpoints.save(path, b"old")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("magmatch.atomic.os.fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        checkpoints.save(path, b"new")
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_else_opens_files_for_writing():
    marks = ('open("w', 'open("x', 'open("a', "write_text(", "write_bytes(", "atomic_write(")
    users = {
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if any(mark in path.read_text(encoding="utf-8") for mark in marks)
    }
    # Sent logs are passing copies in a folder of their own; the lock of a folder of states has no content.
    assert users == {"logs/uploads.py", "logs/work.py", "bodies/checkpoints.py"}
