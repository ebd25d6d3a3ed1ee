# SPDX-License-Identifier: BSD-3-Clause
"""ROS 2 bag folders: ``metadata.yaml`` and the files it names, as one log."""

from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from magmatch.data.logs.log import Batch, Batcher, Log, Loss, Topic
from magmatch.data.logs.source import MAX_CHUNK, MAX_RATIO
from magmatch.data.tables.text import read_bytes
from magmatch.data.tables.yaml_text import load_yaml
from magmatch.errors import DataFormatError, MissingExtraError

METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap")
MAX_METADATA = 4 << 20  # topic tables of large bags make it long
MAX_MESSAGE = 1 << 20  # bytes of one field, pose or tf message; an honest one never reaches it


class JoinedLog:
    """Several files of one recording, read as one.

    Parameters
    ----------
    path : Path
        The folder.
    parts : sequence of Log
        In the order of recording.
    unpack : callable
        Applied to every payload (recorders may compress messages one by one).
    losses : sequence of Loss
        What is known to be lost already.
    """

    def __init__(
        self, path: Path, parts: Sequence[Log], unpack: Callable[[bytes], bytes] | None, losses: Sequence[Loss]
    ) -> None:
        self.path, self._parts, self._unpack, self._lost = path, parts, unpack, list(losses)

    def close(self) -> None:
        """Let go of the files."""
        for part in self._parts:
            part.close()

    def losses(self) -> list[Loss]:
        """What was left out so far, in all files."""
        inside = [
            Loss(loss.start, loss.stop, f"{loss.words} (in {part.path.name})")
            for part in self._parts
            for loss in part.losses()
        ]
        return self._lost + inside

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        joined: dict[tuple[str, str, str], Topic] = {}
        for topic in (topic for part in self._parts for topic in part.topics()):
            key = (topic.name, topic.type, topic.encoding)
            known = joined.get(key, topic)
            if known is topic or not topic.count:
                joined.setdefault(key, topic)
                continue
            first = min(known.first_ns, topic.first_ns) if known.count else topic.first_ns
            joined[key] = Topic(*key, known.count + topic.count, first, max(known.last_ns, topic.last_ns))
        return sorted(joined.values(), key=lambda topic: (topic.name, topic.type))

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Messages of some topics, file after file."""
        for batch in (batch for part in self._parts for batch in part.messages(topics)):
            if self._unpack is None:
                yield batch
                continue
            batcher = Batcher()  # a full batch may be too much once it is unpacked
            for log_ns, payload in zip(batch.log_ns, batch.payloads, strict=True):
                full = batcher.add(0, batch.channel, log_ns, self._unpack(payload))
                if full is not None:
                    yield full
            yield from batcher.rest()


def open_ros2_folder(folder: str | Path, open_file: Callable[[Path], Log], *, recover: bool = False) -> JoinedLog:
    """Open a ROS 2 bag folder.

    Parameters
    ----------
    folder : path
        Holds ``metadata.yaml``, or at least files of one recording.
    open_file : callable
        Opens one of them.
    recover : bool
        Go on where a file is missing or cannot be opened, and note it.

    Returns
    -------
    JoinedLog
    """
    folder = Path(folder)
    about = read_metadata(folder)
    files, losses = _files(folder, about, recover=recover)
    parts: list[Log] = []
    try:
        for file in files:
            try:
                parts.append(open_file(file))
            except DataFormatError as error:
                if not recover:
                    raise
                losses.append(Loss(0, 0, f"a whole file: {error}"))
    except BaseException:
        for part in parts:
            part.close()
        raise
    if not parts:
        raise DataFormatError(folder, f"holds no {' or '.join(SUFFIXES)} file that can be read")
    return JoinedLog(folder, parts, _unpacker(folder, about), losses)


def read_metadata(folder: Path) -> dict[str, Any]:
    """What ``metadata.yaml`` says of a bag; empty where there is none."""
    path = folder / METADATA
    if not path.exists():
        return {}
    raw = read_bytes(path, MAX_METADATA + 1)
    if len(raw) > MAX_METADATA:
        raise DataFormatError(path, f"is larger than {MAX_METADATA} bytes; delete it to read the bag without it")
    try:
        content = load_yaml(raw.decode("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, ValueError) as error:
        if isinstance(error, DataFormatError):
            raise
        words = " ".join(str(error).split())[:120]
        raise DataFormatError(path, f"is not YAML ({words}); delete it to read the bag without it") from None
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(about, dict):
        message = "expected rosbag2_bagfile_information in it; delete it to read the bag without it"
        raise DataFormatError(path, message)
    return about


def _files(folder: Path, about: dict[str, Any], *, recover: bool) -> tuple[list[Path], list[Loss]]:
    """Files of the recording in order; only names inside the folder are followed."""
    present = sorted(p for p in folder.iterdir() if p.suffix in SUFFIXES and p.is_file())
    packed = sorted(p.name for p in folder.iterdir() if p.name.endswith((".db3.zstd", ".mcap.zstd")))
    if packed:
        message = f"its files are compressed as a whole; decompress them first (unzstd {packed[0]})"
        raise DataFormatError(folder, message)
    named = about.get("relative_file_paths")
    if named is None:
        return present, []
    if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
        raise DataFormatError(folder / METADATA, "expected a list of names in relative_file_paths")
    names = [Path(name).name for name in named]  # old recorders wrote the folder in front
    stray = [name for name in named if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name]
    if stray:
        raise DataFormatError(folder / METADATA, f"names a file outside the folder: {stray[0]!r}")
    missing = [name for name in names if not (folder / name).is_file()]
    if missing and not recover:
        message = f"names {missing[0]!r}, which is not in the folder; --recover reads the other files"
        raise DataFormatError(folder / METADATA, message)
    losses = [Loss(0, 0, f"a whole file: {name!r} is not in the folder") for name in missing]
    found = [folder / name for name in dict.fromkeys(names) if name not in missing]
    return (found or present), losses


def _unpacker(folder: Path, about: dict[str, Any]) -> Callable[[bytes], bytes] | None:
    """How messages are compressed one by one, where they are."""
    if str(about.get("compression_mode", "")).upper() != "MESSAGE":
        return None
    kind = about.get("compression_format")
    if kind != "zstd":
        raise DataFormatError(folder / METADATA, f"messages are compressed with {str(kind)[:40]!r}, expected zstd")
    try:
        import zstandard
    except ImportError:
        feature = "reading a ROS 2 bag with zstd messages"
        raise MissingExtraError(feature, "ros") from None
    decompressor, budget = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK), MAX_CHUNK

    def unpack(payload: bytes) -> bytes:
        nonlocal budget
        try:
            content = decompressor.stream_reader(payload, read_across_frames=True).read(MAX_MESSAGE)
        except (zstandard.ZstdError, ValueError):
            return b""  # no message: named as such where it is decoded
        budget += MAX_RATIO * len(payload) - len(content)
        if budget < 0:
            message = f"messages decompress to more than {MAX_RATIO} times their size: refused as a zip bomb"
            raise DataFormatError(folder, message)
        return content

    return unpack
