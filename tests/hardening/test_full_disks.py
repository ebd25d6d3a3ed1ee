# SPDX-License-Identifier: BSD-3-Clause
"""A disk that is full or fails: one error that names the file, the old file whole, nothing left behind."""

import errno
import io
import os
import re
import resource
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
    "disk full on the way": (errno.ENOSPC, lambda e: full(e, 60)),
    "disk that fails on the way": (errno.EIO, lambda e: full(e, 60)),
    "quota used up": (errno.EDQUOT, lambda e: full(e, 1)),
    "disk full when flushed": (errno.ENOSPC, lambda e: ("magmatch.atomic.os.fsync", failing(e))),
    "disk that fails when flushed": (errno.EIO, lambda e: ("magmatch.atomic.os.fsync", failing(e))),
    "no room for the name": (errno.ENOSPC, lambda e: ("pathlib.Path.replace", failing(e))),
    "disk that fails when renaming": (errno.EIO, lambda e: ("pathlib.Path.replace", failing(e))),
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


COMMANDS = {
    "map": ["map", "{survey}", "--out", "{out}/room.map", "--config", "{folder}/field.yaml"],
    "view": ["view", "{survey}", "--out", "{out}/page.html"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, writers):
    """A survey, and settings with which its map is made at once."""
    made = tmp_path_factory.mktemp("full")
    writers["survey .csv"].write(0, made / "survey.csv")
    settings = "{prior: spline, lengthscale: 0.8, signal_sd: 1.0e-5, noise_sd: 1.0e-7, spacing: 0.5}"
    (made / "field.yaml").write_text(settings)
    return made


def run_limited(command, folder, out, limit=None):
    """Run the program, with files limited to some bytes."""
    places = {"survey": folder / "survey.csv", "out": out, "folder": folder}
    words = [word.format(**places) for word in command]
    path = os.pathsep.join([str(Path(magmatch.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "magmatch", *words], capture_output=True, text=True, check=False, timeout=120,
        env=os.environ | {"PYTHONPATH": path, "COLUMNS": "400"},
        preexec_fn=lambda: limit and resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )  # fmt: skip


def check_fault(done, out, before):
    """Exit code 1, one line of what went wrong, and the folder as it was."""
    assert done.returncode == 1, done
    assert "Traceback" not in done.stderr
    faults = [line for line in done.stderr.splitlines() if line.startswith("magmatch: ")]
    assert len(faults) == 1
    assert str(out) in faults[0]
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    return faults[0]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_may_not_write_so_much_says_so(name, folder, tmp_path):
    old = {Path(word).name: b"old" for word in COMMANDS[name] if word.startswith("{out}/")}
    for file, content in old.items():
        (tmp_path / file).write_bytes(content)
    done = run_limited(COMMANDS[name], folder, tmp_path, limit=2000)
    assert os.strerror(errno.EFBIG) in check_fault(done, tmp_path, old)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_device_is_named(writer):
    with pytest.raises(OSError, match="No space left") as caught:
        writer.write(0, Path("/dev/full"))
    assert caught.value.filename == "/dev/full"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_nobody_can_hold_ends_in_one_line(folder):
    path = os.pathsep.join([str(Path(magmatch.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    with Path("/dev/full").open("wb") as full_device:
        done = subprocess.run(
            [sys.executable, "-m", "magmatch", "info", folder / "survey.csv"], stdout=full_device, text=True,
            stderr=subprocess.PIPE, check=False, env=os.environ | {"PYTHONPATH": path},
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "magmatch: No space left on device"
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
