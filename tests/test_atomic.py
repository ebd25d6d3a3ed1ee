# SPDX-License-Identifier: BSD-3-Clause
"""A file is there whole or not at all."""

import errno
import os
import stat
from pathlib import Path

import pytest

from magmatch.atomic import atomic_write
from magmatch.errors import DataFormatError


def test_old_file_is_in_place_until_the_block_ends(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with atomic_write(path) as stream:
        stream.write(b"new")
        stream.flush()
        assert path.read_bytes() == b"old"
        (temporary,) = (p for p in tmp_path.iterdir() if p != path)
        assert temporary.name.startswith(".a.bin.tmp-")
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError])
def test_exception_keeps_the_old_file_and_leaves_nothing_behind(tmp_path, error):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def write_half():
        with atomic_write(path) as stream:
            stream.write(b"half")
            raise error

    with pytest.raises(error):
        write_half()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_a_read_only_disk_is_told_of_the_file_asked_for(tmp_path, monkeypatch):
    def deny(self, *_args, **_named):
        raise OSError(errno.EROFS, "Read-only file system", str(self))

    monkeypatch.setattr(Path, "open", deny)
    monkeypatch.setattr(Path, "unlink", deny)
    with pytest.raises(OSError, match=r"/a\.bin'$"), atomic_write(tmp_path / "a.bin"):
        pass


def test_missing_folder_is_named(tmp_path):
    with (
        pytest.raises(DataFormatError, match=r"nowhere does not exist; create it first"),
        atomic_write(tmp_path / "nowhere" / "a.bin"),
    ):
        pass


def test_folder_is_not_overwritten(tmp_path):
    with pytest.raises(DataFormatError, match="is a folder"), atomic_write(tmp_path):
        pass


def test_link_is_followed_and_permissions_stay(tmp_path):
    real, link = tmp_path / "real.bin", tmp_path / "link.bin"
    real.write_bytes(b"old")
    real.chmod(0o640)
    link.symlink_to(real)
    with atomic_write(link) as stream:
        stream.write(b"new")
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def test_device_is_written_through_and_not_replaced():
    with atomic_write(os.devnull) as stream:
        stream.write(b"gone")
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)


def test_longest_name_can_be_written(tmp_path):
    path = tmp_path / ("ä" * 127)
    with atomic_write(path) as stream:
        stream.write(b"x")
    assert path.read_bytes() == b"x"
