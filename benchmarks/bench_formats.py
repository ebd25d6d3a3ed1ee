# SPDX-License-Identifier: BSD-3-Clause
"""Reading long recordings in every format: time and peak memory, against the libraries of the formats alone.

Run ``python benchmarks/bench_formats.py [FORMAT...] [--gigabytes 1.0] [--folder DIR]``; needs ``magmatch[test]``.
Logs hold a magnetometer at 200 Hz, poses at 100 Hz and an unrelated camera; tables hold samples only.
"""

import json
import logging
import struct
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import alone, arguments, peak_mib, timed

SECOND, START, ROWS = 1_000_000_000, 1_700_000_000, 20_000
FRAME_BYTES, BYTES_PER_SECOND = 100_000, 200 * 130 + 100 * 95 + 100_000
MAG, POSE, IMAGE = "sensor_msgs/msg/MagneticField", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/CompressedImage"
TOPICS = {"/imu/mag": MAG, "/pose": POSE, "/camera": IMAGE}
WANTED = ["/imu/mag", "/pose"]
COLUMNS = ("format", "reader", "read", "processor", "peak memory", "of magmatch's time")


def messages(gigabytes: float, *, is_ros1: bool) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time (ns) and payload, packed by hand, which is much faster than by type."""
    rng = np.random.default_rng(0)
    front = b"" if is_ros1 else b"\0\1\0\0"
    sequence = bytes(4) if is_ros1 else b""
    for s in range(int(gigabytes * 1e9 / BYTES_PER_SECOND)):
        field = rng.normal([2e-5, 0, -4e-5], 1e-6, (200, 3))
        for i in range(200):
            head = front + sequence + struct.pack("<II", START + s, i * 5_000_000)
            stamp = (START + s) * SECOND + i * 5_000_000
            # Seven letters and the zero of CDR; both then end where doubles may stand.
            named = struct.pack("<I", 8) + b"mag_link" if is_ros1 else struct.pack("<I8s", 8, b"mag_lin\0") + bytes(4)
            yield "/imu/mag", stamp, head + named + field[i].tobytes() + bytes(72)
            if i % 2 == 0:
                a = stamp / 1e11
                pose = (np.cos(a), np.sin(a), 0.1 * np.sin(7 * a), 0.0, 0.0, np.sin(a / 2), np.cos(a / 2))
                named = struct.pack("<I", 3) + b"map" if is_ros1 else struct.pack("<I4s", 4, b"map\0")
                yield "/pose", stamp, head + named + struct.pack("<7d", *pose)
        yield "/camera", (START + s) * SECOND, front + rng.bytes(FRAME_BYTES)


def tables(gigabytes: float, bytes_per_row: int) -> Iterator[dict[str, np.ndarray]]:
    """Columns of a survey, some rows at a time."""
    rng = np.random.default_rng(0)
    n = int(gigabytes * 1e9 / bytes_per_row)
    for start in range(0, n, ROWS):
        k = np.arange(start, min(n, start + ROWS))
        a, zero = 0.5 * k / 1e4, np.zeros(len(k))
        b = rng.normal([2e-5, 0, -4e-5], 1e-6, (len(k), 3)).T
        yield {"t": START + k / 200, "x": np.cos(a), "y": np.sin(a), "z": 0.1 * np.sin(7 * a), "bx": b[0], "by": b[1],
               "bz": b[2], "qx": zero, "qy": zero, "qz": np.sin(a / 2), "qw": np.cos(a / 2)}  # fmt: skip


def write_mcap(path: Path, gigabytes: float) -> None:
    """Chunks are not compressed."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        schemas = [writer.register_schema(kind, "ros2msg", b"") for kind in TOPICS.values()]
        opened = {t: writer.register_channel(t, "cdr", s) for t, s in zip(TOPICS, schemas, strict=True)}
        for topic, stamp, payload in messages(gigabytes, is_ros1=False):
            writer.add_message(opened[topic], stamp, payload, stamp)
        writer.finish()


def write_bag(path: Path, gigabytes: float, *, is_ros1: bool) -> None:
    """A ROS 1 bag, or a ROS 2 bag with SQLite."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    writer = Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        opened = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in TOPICS.items()}
        for topic, stamp, payload in messages(gigabytes, is_ros1=is_ros1):
            writer.write(opened[topic], stamp, payload)


def write_csv(path: Path, gigabytes: float) -> None:
    with path.open("w") as stream:
        for i, columns in enumerate(tables(gigabytes, 187)):
            stream.write(",".join(columns) + "\n" if i == 0 else "")
            rows = zip(*(map(repr, column.tolist()) for column in columns.values()), strict=True)
            stream.write("\n".join(map(",".join, rows)) + "\n")


def write_parquet(path: Path, gigabytes: float) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    writer = None
    for columns in tables(gigabytes, 70):
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    writer.close()


def with_magmatch(path: str) -> int:
    """From the file to a checked survey, with all that ``magmatch map`` imports."""
    import magmatch.field.build  # noqa: F401
    from magmatch.data.read import read_survey

    return len(read_survey(path))


def with_mcap(path: str, **how: bool) -> int:
    """Messages, not decoded, by log time."""
    return sum(1 for _ in mcap_messages(path, **how))


def with_mcap_unordered(path: str) -> int:
    """The same in the order of the file, which is its fastest way."""
    return with_mcap(path, log_time_order=False)


def with_mcap_and_rosbags(path: str) -> int:
    """The mcap library for the file and rosbags' types for the messages, as one would without magmatch."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    found = mcap_messages(path, log_time_order=False)
    return sum(1 for _ in (store.deserialize_cdr(message.data, schema.name) for schema, _, message in found))


def mcap_messages(path: str, **how: bool) -> Iterator[tuple[Any, Any, Any]]:
    from mcap.reader import make_reader

    with Path(path).open("rb") as stream:
        yield from make_reader(stream).iter_messages(topics=WANTED, **how)


def with_rosbags(path: str) -> int:
    """Messages, not decoded."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with (Reader1 if path.endswith(".bag") else Reader2)(path) as reader:
        return sum(1 for _ in reader.messages([c for c in reader.connections if c.topic in WANTED]))


def with_pandas(path: str) -> int:
    import pandas as pd

    return len(pd.read_csv(path) if path.endswith(".csv") else pd.read_parquet(path))


FORMATS: dict[str, tuple[str, Callable[[Path, float], None], list[Callable[..., int]]]] = {
    "mcap": ("log.mcap", write_mcap, [with_mcap, with_mcap_unordered, with_mcap_and_rosbags]),
    "bag": ("log.bag", partial(write_bag, is_ros1=True), [with_rosbags]),
    "db3": ("log", partial(write_bag, is_ros1=False), [with_rosbags]),
    "csv": ("log.csv", write_csv, [with_pandas]),
    "parquet": ("log.parquet", write_parquet, [with_pandas]),
}


def measure(reader: str, path: str) -> None:
    """In a process of its own: seconds of the processor, peak memory."""
    logging.disable()
    n, _, cpu = timed(globals()[reader], path)
    print(json.dumps({"n": n, "cpu": cpu, "mib": peak_mib()}))


def compare(name: str, folder: Path, gigabytes: float, repeats: int) -> Iterator[list[str]]:
    """Write one format and read it with magmatch and without, in turns; rows of the table."""
    file, write, peers = FORMATS[name]
    path = folder / file
    write(path, gigabytes)
    runs: dict[str, list[dict[str, float]]] = {reader.__name__: [] for reader in (with_magmatch, *peers)}
    for _ in range(repeats):
        for reader, found in runs.items():
            found.append(alone(__file__, "--measure", reader, path))
    ours = min(run["cpu"] for run in runs["with_magmatch"])
    for reader, found in runs.items():
        cpu, mib = min(run["cpu"] for run in found), max(run["mib"] for run in found)
        title = reader.removeprefix("with_").replace("_", " ")
        yield [name, title, f"{found[0]['n']:,}", f"{cpu:.1f} s", f"{mib:.0f} MiB", f"{cpu / ours:.2f}"]


def main() -> None:
    asked = arguments(__doc__, tuple(FORMATS), gigabytes=1.0, folder=Path, repeats=2, measure=[], save=saver)
    if asked.measure:
        measure(*asked.measure)
        return
    print(", ".join(f"{name} {version(name)}" for name in ("mcap", "rosbags", "pandas", "pyarrow", "numpy")))
    rows: list[list[str]] = []
    for name in asked.words:
        with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
            rows += compare(name, Path(folder), asked.gigabytes, asked.repeats)
    show(COLUMNS, rows, asked.save)


if __name__ == "__main__":
    main()
