# SPDX-License-Identifier: BSD-3-Clause
"""Clients' states are written by the package's own writer, whole or not at all."""

from pathlib import Path

import magmatch_serve

SOURCE = Path(magmatch_serve.__file__).parent


def test_nothing_else_opens_files_for_writing():
    marks = ('open("w', 'open("x', 'open("a', "write_text(", "write_bytes(", "atomic_write(")
    users = {
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if any(mark in path.read_text(encoding="utf-8") for mark in marks)
    }
    # Sent logs are passing copies in a folder of their own; the lock of a folder of states has no content.
    assert users == {"logs/uploads.py", "logs/work.py", "bodies/checkpoints.py"}
