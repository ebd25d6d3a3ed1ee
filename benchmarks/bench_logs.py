# SPDX-License-Identifier: BSD-3-Clause
"""Reading an MCAP log of 1 GB: time and memory of the reading stage, against the libraries of the format alone.

Run ``python benchmarks/bench_logs.py [--gigabytes 1.0] [--compression LZ4]``; needs the extras ``ros`` and ``test``.
The log holds hours of a magnetometer at 200 Hz, poses at 100 Hz and an unrelated camera.
"""

import tempfile
from importlib.metadata import version
from pathlib import Path

from bench_formats import TOPICS, measure, messages, with_magmatch

from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import alone, arguments

COLUMNS = ("reader", "messages", "processor", "clock", "peak memory", "speed of magmatch over it")
WANTED = [topic for topic in TOPICS if topic != "/camera"]


def write_log(path, gigabytes, compression):
    """Write the log with the mcap library; its length in seconds."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression])
        writer.start("ros2")
        schemas = [writer.register_schema(name, "ros2msg", b"") for name in TOPICS.values()]
        channels = {t: writer.register_channel(t, "cdr", s) for t, s in zip(TOPICS, schemas, strict=True)}
        first = last = None
        for topic, stamp, payload in messages(gigabytes, is_ros1=False):
            writer.add_message(channels[topic], stamp, payload, stamp)
            first, last = first or stamp, stamp
        writer.finish()
    return (last - first) / 1e9 + 1


def messages_of(path, **how):
    from mcap.reader import make_reader

    with Path(path).open("rb") as stream:
        yield from make_reader(stream).iter_messages(topics=WANTED, **how)


def with_mcap(path):
    """The mcap library alone, messages not decoded."""
    return sum(1 for _ in messages_of(path))


def with_mcap_unordered(path):
    """The same in the order of the file, which is its fastest way."""
    return sum(1 for _ in messages_of(path, log_time_order=False))


def with_mcap_and_rosbags(path):
    """The mcap library for the file and rosbags' types for the messages, as one would without magmatch."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    decoded = (
        store.deserialize_cdr(message.data, schema.name)
        for schema, _, message in messages_of(path, log_time_order=False)
    )
    return sum(1 for _ in decoded)


READERS = {r.__name__: r for r in (with_magmatch, with_mcap, with_mcap_unordered, with_mcap_and_rosbags)}


def compare(path, repeats):
    """All readers in turns, so that what else the machine does hits all of them."""
    runs = {name: [] for name in READERS}
    for _ in range(repeats):
        for name, found in runs.items():
            found.append(alone(__file__, "--measure", name, path))
    ours = min(run["cpu"] for run in runs["with_magmatch"])
    rows = []
    for name, found in runs.items():
        best, cpu = min(run["seconds"] for run in found), min(run["cpu"] for run in found)
        mib, title = max(run["mib"] for run in found), name.removeprefix("with_").replace("_", " ")
        rows.append(
            [title, f"{found[0]['n']:,}", f"{cpu:.1f} s", f"{best:.1f} s", f"{mib:.0f} MiB", f"{cpu / ours:.2f}"]
        )
    return rows


def main():
    asked = arguments(__doc__, gigabytes=1.0, compression="NONE", folder=Path, repeats=2, measure=[], save=saver)
    if asked.measure:
        measure(READERS[asked.measure[0]], asked.measure[1])
        return
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        path = Path(folder) / "log.mcap"
        seconds = write_log(path, asked.gigabytes, asked.compression)
        print(f"{path.stat().st_size / 1e9:.2f} GB, {seconds / 3600:.2f} h, chunks {asked.compression.lower()};")
        print(", ".join(f"{name} {version(name)}" for name in ("mcap", "rosbags", "numpy")))
        show(COLUMNS, compare(path, asked.repeats), asked.save)


if __name__ == "__main__":
    main()
