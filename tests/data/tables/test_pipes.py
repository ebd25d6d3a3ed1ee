# SPDX-License-Identifier: BSD-3-Clause
"""What comes through an open pipe is read as the file it was, as often as it is asked for."""

import gzip
import os
import threading
import time
import zipfile
from contextlib import contextmanager
from io import BytesIO

import numpy as np
import pytest
from scipy.io import savemat

from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.read import read_survey
from magmatch.data.tables import pipes
from magmatch.data.tables.text import text_lines
from magmatch.errors import DataFormatError

pytestmark = pytest.mark.skipif(not os.path.isdir("/dev/fd"), reason="this system names no open pipes")  # noqa: PTH112


@contextmanager
def piped(content):
    """Name of an open pipe through which the content comes, once, as of ``<(cat FILE)``."""
    end, source = os.pipe()

    def write():
        try:
            _write_all(source, content)
        except BrokenPipeError:
            pass
        finally:
            os.close(source)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield f"/dev/fd/{end}"
    finally:
        os.close(end)
        writer.join()


def _write_all(source, content):
    with os.fdopen(os.dup(source), "wb") as stream:
        stream.write(content)


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "parquet", "mcap"])
def test_a_survey_of_any_format_comes_through_a_pipe(kind, walk, tmp_path):
    pytest.importorskip({"parquet": "pyarrow", "mcap": "mcap"}.get(kind, "numpy"))
    from magmatch.data.write import SURVEY_WRITERS

    plain = tmp_path / f"walk.{kind.removesuffix('.gz')}"
    SURVEY_WRITERS[plain.suffix](walk, plain)
    content = gzip.compress(plain.read_bytes()) if kind.endswith("gz") else plain.read_bytes()
    with piped(content) as name:
        read, again = read_survey(name), read_survey(name)
    np.testing.assert_array_equal(read.field, read_survey(plain).field)
    np.testing.assert_array_equal(again.positions, read.positions)


def test_what_an_archive_says_of_pauses_is_read_through_a_pipe_too():
    content, rows = BytesIO(), "".join(f"{t},1,2,-45\n" for t in (0.0, 1.0, 2.0))
    with zipfile.ZipFile(content, "w") as archive:
        head = "Time (s),Magnetic field x (µT),Magnetic field y (µT),Magnetic field z (µT)\n"
        archive.writestr("Magnetometer.csv", head + rows)
        about = "event,experiment time,system time\nSTART,0,100\nPAUSE,1.5,101.5\nSTART,1.5,111.5\n"
        archive.writestr("meta/time.csv", about)
    with piped(content.getvalue()) as name:
        log = read_phone_log(name)
    np.testing.assert_allclose(log.streams["field"].times, [0, 1, 12])


def test_faults_of_a_packed_file_are_told_of_the_name_that_was_given(tmp_path):
    content = BytesIO()
    savemat(content, {"x": np.arange(20.0)})
    (tmp_path / "walk.mat").write_bytes(gzip.compress(content.getvalue()))
    with piped(content.getvalue()) as name:
        for path in (name, str(tmp_path / "walk.mat")):
            with pytest.raises(DataFormatError) as error:
                read_survey(path)
            assert str(error.value).startswith(f"{path}: expected columns")


def test_an_endless_pipe_is_refused(monkeypatch):
    monkeypatch.setattr(pipes, "MOST", 1000)
    with piped(b"1,2,3\n" * 500) as name, pytest.raises(DataFormatError, match="more than 1000 bytes"):
        read_survey(name)


@contextmanager
def written(path, content, is_slow=False):
    """A pipe with a name that somebody writes to; a slow one has opened it before, and writes once it is read."""
    handle = os.open(path, os.O_RDWR) if is_slow else None

    def write():
        if handle is None:
            path.write_bytes(content)
        else:
            time.sleep(0.1)
            _write_all(handle, content)
            os.close(handle)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    yield path
    writer.join(10)
    assert not writer.is_alive()


@pytest.mark.parametrize("is_slow", [False, True])
def test_a_pipe_with_a_name_of_its_own_is_read_like_a_file(is_slow, walk, tmp_path, monkeypatch):
    if is_slow:
        monkeypatch.setattr(pipes, "WAIT", 0.01)
    os.mkfifo(tmp_path / "walk.csv")
    walk.save(tmp_path / "plain.csv")
    with written(tmp_path / "walk.csv", (tmp_path / "plain.csv").read_bytes(), is_slow) as name:
        read, again = read_survey(name), read_survey(name)
    np.testing.assert_array_equal(read.field, walk.field)
    np.testing.assert_array_equal(again.field, walk.field)


def test_a_pipe_that_is_made_anew_under_its_name_is_read_anew(tmp_path):
    for text in ("one", "two"):
        os.mkfifo(tmp_path / "pipe")  # which may get the number of the one before
        with written(tmp_path / "pipe", text.encode()) as name:
            assert text_lines(name) == [text]
        name.unlink()


def test_a_pipe_to_which_nobody_writes_is_refused_after_a_while(tmp_path, monkeypatch):
    monkeypatch.setattr(pipes, "WAIT", 0.05)
    os.mkfifo(tmp_path / "walk.csv")
    with pytest.raises(DataFormatError, match=r"walk\.csv: is a pipe to which nothing is written for 0\.05 s"):
        read_survey(tmp_path / "walk.csv")


def test_a_folder_is_read_without_its_pipes(tmp_path, monkeypatch):
    monkeypatch.setattr(pipes, "WAIT", 60.0)
    (tmp_path / "Magnetometer.csv").write_text("time,seconds_elapsed,x,y,z\n1000000000,0,1,2,3\n")
    os.mkfifo(tmp_path / "Gyroscope.csv")
    assert set(read_phone_log(tmp_path).streams) == {"field"}
