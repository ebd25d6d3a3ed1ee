# SPDX-License-Identifier: BSD-3-Clause
"""Logs that lie about their size cost a worker at most: never a 500, and the next log is answered as before."""

import gzip
import resource

import numpy as np
import pytest
import scipy.io

from magmatch_serve.catalogue import look_at
from magmatch_serve.config import ServeConfig
from magmatch_serve.logs.bounds import bounded
from magmatch_serve.logs.work import WhereOfLog, work_on_log

LARGE = 240 << 20


def matlab_bomb(path):
    """Zeros that are packed a thousand times."""
    scipy.io.savemat(path, {"x": np.zeros(LARGE // 8)}, do_compression=True)


def gzip_bomb(path):
    with gzip.open(path, "wb", compresslevel=1) as stream:
        stream.write(b"\x89MCAP0\r\n")
        for _ in range(LARGE >> 20):
            stream.write(bytes(1 << 20))


def text_bomb(path):
    """A table of one row again and again."""
    with gzip.open(path, "wb", compresslevel=1) as stream:
        stream.write(b"t,x,y,z,bx,by,bz\n")
        for _ in range(50):
            stream.write(b"1,2,3,4,5,6,7\n" * 75_000)


def mcap_bomb(path):
    writer = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        made = writer.Writer(stream, chunk_size=2 * LARGE, enable_crcs=False)
        made.start()
        schema = made.register_schema("sensor_msgs/msg/MagneticField", "ros2msg", b"")
        channel = made.register_channel("/mag", "cdr", schema)
        for i in range(6):
            made.add_message(channel, i, bytes(LARGE // 6), i)
        made.finish()


def parquet_bomb(path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    zeros = np.zeros(LARGE // 8)
    pq.write_table(pa.table(dict.fromkeys(("t", "x", "y", "z", "bx", "by", "bz"), zeros)), path, compression="zstd")


def hdf5_bomb(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name in ("t", "x", "y", "z", "bx", "by", "bz"):
            file.create_dataset(name, (1, 1 << 40), "f8", chunks=(1, 1 << 20))


BOMBS = {
    "a MATLAB file": matlab_bomb, "gzip of a log": gzip_bomb, "gzip of a table": text_bomb, "MCAP": mcap_bomb,
    "Parquet": parquet_bomb, "HDF5": hdf5_bomb,
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_within_bounds_and_leaves_nothing_behind(name, hall, tmp_path):
    BOMBS[name](tmp_path / "log")
    before = {kind: resource.getrlimit(kind) for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)}
    config = ServeConfig(states=tmp_path, max_reading=120 << 20, max_unpacked=120 << 20)
    found = work_on_log(hall.map, look_at(hall.map), tmp_path / "log", WhereOfLog(), config)
    assert found.status in {413, 422}, found.message
    assert str(tmp_path) not in found.message
    assert {kind: resource.getrlimit(kind) for kind in before} == before


def test_what_takes_too_much_memory_is_a_memory_error():
    with pytest.raises(MemoryError), bounded(100 << 20, 1 << 20, 60):
        bytes(200 << 20)
    assert len(bytes(200 << 20)) == 200 << 20
