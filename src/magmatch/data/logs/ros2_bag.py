# SPDX-License-Identifier: BSD-3-Clause
"""ROS 2 bag folders: ``metadata.yaml`` and the files it names, as one log.

Ours, because rosbags needs the metadata whole and every file present, unpacks to the disk, and bounds no message.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from magmatch.data.logs.bounds import DamagedError, Decompressor
from magmatch.data.logs.log import Count, Log, Loss, Message, Topic, topics_of
from magmatch.data.tables.text import read_bytes
from magmatch.data.tables.yaml_text import load_yaml
from magmatch.errors import DataFormatError

METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap")
MAX_METADATA = 4 << 20  # topic tables of large bags make it long
MAX_MESSAGE = 1 << 20  # bytes of one field, pose or tf message; an honest one never reaches it


class JoinedLog:
    """Files of one recording in order, read as one; messages may be compressed one by one."""

    def __init__(self, path: Path, parts: Sequence[Log], losses: Sequence[Loss], *, is_packed: bool) -> None:
        self.path, self._parts, self._lost = path, parts, list(losses)
        self._decompressor = Decompressor(path) if is_packed else None

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def losses(self) -> list[Loss]:
        """What was left out so far, in all files."""
        inside = [(part.path.name, loss) for part in self._parts for loss in part.losses()]
        return self._lost + [replace(loss, words=f"{loss.words} (in {name})") for name, loss in inside]

    def topics(self) -> list[Topic]:
        """All topics, by name."""
        found = [topic for part in self._parts for topic in part.topics()]
        return topics_of((topic.channel, Count(topic.count, topic.first_ns, topic.last_ns)) for topic in found)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, file after file."""
        for part in self._parts:
            for channel, log_ns, payload in part.messages(topics):
                yield channel, log_ns, self._unpacked(payload)

    def _unpacked(self, payload: bytes) -> bytes:
        """A message as it was sent; empty where it cannot be unpacked, which the decoder then names."""
        if self._decompressor is None:
            return payload
        try:
            return self._decompressor.expand("zstd", payload, MAX_MESSAGE)
        except DamagedError:
            return b""


def open_ros2_folder(folder: str | Path, open_file: Callable[[Path], Log], *, recover: bool = False) -> JoinedLog:
    """Open a folder with ``metadata.yaml``, or at least the files of one recording.

    With `recover`, files that are missing or cannot be opened are left out and noted.
    """
    folder = Path(folder)
    about = _metadata(folder)
    files, losses = _files(folder, about, recover=recover)
    is_packed = str(about.get("compression_mode", "")).upper() == "MESSAGE"
    if is_packed and about.get("compression_format") != "zstd":
        message = f"messages are compressed with {str(about.get('compression_format'))[:40]!r}, expected zstd"
        raise DataFormatError(folder / METADATA, message)
    parts: list[Log] = []
    with ExitStack() as opened:
        for file in files:
            try:
                parts.append(opened.enter_context(closing(open_file(file))))
            except DataFormatError as error:
                if not recover:
                    raise
                losses.append(Loss(0, 0, f"a whole file: {error}"))
        opened.pop_all()  # all are open: the log closes them
    if not parts:
        raise DataFormatError(folder, f"holds no {' or '.join(SUFFIXES)} file that can be read")
    return JoinedLog(folder, parts, losses, is_packed=is_packed)


def _metadata(folder: Path) -> dict[str, Any]:
    """What ``metadata.yaml`` says of a bag; empty where there is none."""
    path = folder / METADATA
    if not path.exists():
        return {}
    advice = "delete it to read the bag without it"
    raw = read_bytes(path, MAX_METADATA + 1)
    if len(raw) > MAX_METADATA:
        raise DataFormatError(path, f"is larger than {MAX_METADATA} bytes; {advice}")
    try:
        content = load_yaml(raw.decode("utf-8"))
    except (yaml.YAMLError, ValueError) as error:
        raise DataFormatError(path, f"is not YAML ({' '.join(str(error).split())[:120]}); {advice}") from None
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(about, dict):
        raise DataFormatError(path, f"expected rosbag2_bagfile_information in it; {advice}")
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
    stray = [name for name in named if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name]
    if stray:
        raise DataFormatError(folder / METADATA, f"names a file outside the folder: {stray[0]!r}")
    names = list(dict.fromkeys(Path(name).name for name in named))  # old recorders wrote the folder in front
    missing = [name for name in names if not (folder / name).is_file()]
    if missing and not recover:
        message = f"names {missing[0]!r}, which is not in the folder; --recover reads the other files"
        raise DataFormatError(folder / METADATA, message)
    losses = [Loss(0, 0, f"a whole file: {name!r} is not in the folder") for name in missing]
    return [folder / name for name in names if name not in missing] or present, losses
