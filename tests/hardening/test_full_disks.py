# SPDX-License-Identifier: BSD-3-Clause
"""A disk that is full or fails: one error that names the file, the old file whole, nothing left behind."""

import errno
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import magmatch
from magmatch.cli.boundary import FAULT, explain, one_line


class FailingFile(io.FileIO):
    """A file on a disk with little room."""

    room, error = 0, errno.ENOSPC

    def write(self, data):
        if not self.room:
            raise OSError(self.error, os.strerror(self.error))
        part = bytes(data[: self.room])
        self.room -= len(part)
        return super().write(part)


def full(error, room):
    """Replace `Path.open` for new files by one whose writes fail after some bytes."""
    original = Path.open

    def open_failing(self, mode="r", *args, **kwargs):
        if mode != "xb":
            return original(self, mode, *args, **kwargs)
        raw = FailingFile(self, "x")
        raw.room, raw.error = room, error
        return io.BufferedWriter(raw, 512)

    return "pathlib.Path.open", open_failing


def failing(error):
    def fail(*_args, **_kwargs):
        raise OSError(error, os.strerror(error))

    return fail


FAULTS = {
    "disk full at once": (errno.ENOSPC, lambda e: full(e, 0)),
    "disk that fails on the way": (errno.EIO, lambda e: full(e, 60)),
    "quota used up": (errno.EDQUOT, lambda e: full(e, 1)),
    "disk that fails when flushed": (errno.EIO, lambda e: ("magmatch.atomic.os.fsync", failing(e))),
    "no room for the name": (errno.ENOSPC, lambda e: ("pathlib.Path.replace", failing(e))),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_disk_that_fails_is_named_and_the_old_file_stays(fault, writer, tmp_path, monkeypatch):
    path = tmp_path / writer.file
    writer.write(0, path)
    old = path.read_bytes()
    number, patch = FAULTS[fault]
    with monkeypatch.context() as context:
        context.setattr(*patch(number))
        with pytest.raises(OSError, match=re.escape(os.strerror(number))) as caught:
            writer.write(1, path)
    assert (caught.value.errno, caught.value.filename) == (number, str(path))
    words, code = explain(caught.value)
    assert code == FAULT
    assert one_line(words) == f"{path}: {os.strerror(number)}"
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == [writer.file]
    writer.write(1, path)
    assert path.read_bytes() != old


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_device_is_named(writer):
    with pytest.raises(OSError, match="No space left") as caught:
        writer.write(0, Path("/dev/full"))
    assert caught.value.filename == "/dev/full"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_nobody_can_hold_ends_in_one_line(writers, tmp_path):
    writers["survey .csv"].write(0, tmp_path / "survey.csv")
    path = os.pathsep.join([str(Path(magmatch.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    with Path("/dev/full").open("wb") as full_device:
        done = subprocess.run(
            [sys.executable, "-m", "magmatch", "info", tmp_path / "survey.csv"], stdout=full_device, text=True,
            stderr=subprocess.PIPE, check=False, env=os.environ | {"PYTHONPATH": path},
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "magmatch: No space left on device"
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
