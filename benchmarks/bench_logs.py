# SPDX-License-Identifier: BSD-3-Clause
"""Reading a log of 1 GB: time and memory of the reading stage, against the libraries of the format alone.

Run ``python benchmarks/bench_logs.py [--gigabytes 1.0] [--folder DIR]``; needs the extras ``ros`` and ``test``.
The log holds hours of a magnetometer at 200 Hz, poses at 100 Hz and an unrelated camera.
"""

import argparse
import json
import logging
import resource
import struct
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

SECOND = 1_000_000_000
FRAME_BYTES = 100_000
TOPICS = ("/imu/mag", "/pose", "/camera")


def write_log(path: Path, gigabytes: float, compression: str) -> dict[str, int]:
    """Write the log with the mcap library; messages are packed by hand, which is much faster than by type."""
    from mcap.writer import CompressionType, Writer

    rng = np.random.default_rng(0)
    n_seconds = int(gigabytes * 1e9 / (200 * 130 + 100 * 95 + FRAME_BYTES))
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression])
        writer.start("ros2")
        types = ("sensor_msgs/msg/MagneticField", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/CompressedImage")
        schemas = [writer.register_schema(name, "ros2msg", b"") for name in types]
        channels = [writer.register_channel(topic, "cdr", s) for topic, s in zip(TOPICS, schemas, strict=True)]
        for s in range(n_seconds):
            base = 1_700_000_000 * SECOND + s * SECOND
            field = rng.normal([2e-5, 0, -4e-5], 1e-6, (200, 3))
            for i in range(200):
                t = base + i * 5_000_000
                head = b"\0\1\0\0" + struct.pack("<iII8s", t // SECOND, t % SECOND, 8, b"mag_lin\0")
                writer.add_message(channels[0], t, head + bytes(4) + field[i].tobytes() + bytes(72), t)
                if i % 2 == 0:
                    a = t / 1e11
                    pose = (np.cos(a), np.sin(a), 0.1 * np.sin(7 * a), 0.0, 0.0, np.sin(a / 2), np.cos(a / 2))
                    head = b"\0\1\0\0" + struct.pack("<iII4s", t // SECOND, t % SECOND, 4, b"map\0")
                    writer.add_message(channels[1], t, head + struct.pack("<7d", *pose), t)
            image = rng.bytes(FRAME_BYTES)
            writer.add_message(channels[2], base, image, base)
        writer.finish()
    return {"seconds": n_seconds, "bytes": path.stat().st_size}


def with_magmatch(path: str) -> int:
    """The reading stage of ``magmatch map``: from the file to a checked survey, with all that it has imported."""
    import magmatch.field.build  # noqa: F401
    from magmatch.data.read import read_survey

    return len(read_survey(path))


def with_mcap(path: str) -> int:
    """The mcap library alone, messages not decoded."""
    from mcap.reader import make_reader

    with Path(path).open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(topics=TOPICS[:2]))


def with_mcap_unordered(path: str) -> int:
    """The same in the order of the file, which is its fastest way."""
    from mcap.reader import make_reader

    with Path(path).open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(topics=TOPICS[:2], log_time_order=False))


def with_mcap_and_rosbags(path: str) -> int:
    """The mcap library for the file and rosbags' types for the messages, as one would without magmatch."""
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    store, n = get_typestore(Stores.ROS2_HUMBLE), 0
    with Path(path).open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages(topics=TOPICS[:2], log_time_order=False):
            store.deserialize_cdr(message.data, schema.name)
            n += 1
    return n


READERS = (with_magmatch, with_mcap, with_mcap_unordered, with_mcap_and_rosbags)


def measure(reader: str, path: str) -> None:
    """In a process of its own: seconds of the clock and of the processor, peak memory."""
    logging.disable()
    start, busy = time.perf_counter(), time.process_time()
    n = {r.__name__: r for r in READERS}[reader](path)
    seconds, cpu = time.perf_counter() - start, time.process_time() - busy
    mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"n": n, "seconds": seconds, "cpu": cpu, "mib": mib}))


def compare(path: Path, repeats: int) -> None:
    """All readers in turns, so that what else the machine does hits all of them."""
    runs: dict[str, list[dict[str, float]]] = {reader.__name__: [] for reader in READERS}
    for _ in range(repeats):
        for name, found in runs.items():
            command = [sys.executable, __file__, "--measure", name, str(path)]
            found.append(json.loads(subprocess.check_output(command)))
    ours = min(run["cpu"] for run in runs["with_magmatch"])
    print(f"{'reader':24} {'messages':>9} {'s':>7} {'cpu s':>7} {'MB/cpu s':>9} {'peak MiB':>9} {'speed':>6}")
    for name, found in runs.items():
        best, cpu = min(run["seconds"] for run in found), min(run["cpu"] for run in found)
        mib, rate = max(run["mib"] for run in found), path.stat().st_size / 1e6 / cpu
        print(f"{name:24} {found[0]['n']:9} {best:7.1f} {cpu:7.1f} {rate:9.0f} {mib:9.0f} {cpu / ours:6.2f}")
    print("speed: of magmatch over that of the reader, in processor time (the claim: at least 0.5)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--compression", default="NONE", choices=("NONE", "LZ4", "ZSTD"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(*arguments.measure)
        return
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        path = Path(folder) / "log.mcap"
        about = write_log(path, arguments.gigabytes, arguments.compression)
        print(
            f"{about['bytes'] / 1e9:.2f} GB, {about['seconds'] / 3600:.2f} h, chunks {arguments.compression.lower()};"
        )
        print(", ".join(f"{name} {version(name)}" for name in ("mcap", "rosbags", "numpy")))
        compare(path, arguments.repeats)


if __name__ == "__main__":
    main()
