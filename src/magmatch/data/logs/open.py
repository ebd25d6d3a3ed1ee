# SPDX-License-Identifier: BSD-3-Clause
"""Open a recorder log, whatever its container; the files of a ROS 2 bag's folder are one log."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from magmatch.data.logs.log import Count, Log, Message
from magmatch.data.tables.text import is_folder, plain_file, read_bytes
from magmatch.data.tables.yaml_text import mapping_in, read_yaml
from magmatch.errors import DataFormatError, MissingExtraError

NEEDED = ("rosbags", "mcap", "lz4", "zstandard")
METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap")
REINDEX = "'ros2 bag reindex' writes it anew"


def open_log(path: str | Path) -> Log:
    """Open a ROS 1 bag, a ROS 2 bag (folder or file) or an MCAP file, told by content; to be closed when done.

    Raises `DataFormatError` where there is no such log or a damaged one, which then names what mends it;
    `MissingExtraError` without ``ros``.
    """
    if any(find_spec(name) is None for name in NEEDED):
        feature = "reading a ROS bag or MCAP file"
        raise MissingExtraError(feature, "ros")
    from magmatch.data.logs.containers import MCAP_MAGIC, McapLog, Ros1Log, SqliteLog

    if is_folder(path):
        return _open_folder(Path(path))
    head = read_bytes(path, 16)
    version = head.partition(b"\n")[0].decode("ascii", "replace")
    if head.startswith(b"#ROSBAG V") and version != "#ROSBAG V2.0":
        raise DataFormatError(path, f"expected a bag of version 2.0, found {version!r} (rosbag migrates it)")
    kinds: dict[bytes, Callable[[Path], Log]] = {
        MCAP_MAGIC: McapLog, b"#ROSBAG V": Ros1Log, b"SQLite format 3\0": SqliteLog,
    }  # fmt: skip
    for signature, kind in kinds.items():
        if head.startswith(signature):
            return kind(Path(path))
    raise DataFormatError(path, "is no ROS 1 bag, ROS 2 bag or MCAP file, or its first bytes are damaged")


@contextmanager
def opened_log(path: str | Path) -> Iterator[Log]:
    """A log, packed by gzip or not, open for reading; messages name the file that was given."""
    with plain_file(path) as place, closing(open_log(place)) as log:
        log.path = Path(path)
        yield log


class JoinedLog(Log):
    """Files of one recording in order, read as one; messages may be compressed one by one."""

    def __init__(self, path: Path, parts: Sequence[Log], close: Callable[[], None], *, is_packed: bool) -> None:
        self.path, self._parts, self.close, self._is_packed = path, parts, close, is_packed
        topics = dict(enumerate(topic for part in parts for topic in part.topics()))
        self.channels = {key: topic.channel for key, topic in topics.items()}
        self.counts = {key: Count(topic.count, topic.first_ns, topic.last_ns) for key, topic in topics.items()}

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, file after file."""
        for part in self._parts:
            for channel, log_ns, payload in part.messages(topics):
                yield channel, log_ns, self._unpacked(payload) if self._is_packed else payload

    def _unpacked(self, payload: bytes) -> bytes:
        """A message as it was sent."""
        import zstandard

        try:
            return zstandard.ZstdDecompressor().stream_reader(payload, read_across_frames=True).read()
        except zstandard.ZstdError as error:
            message = f"says that messages are compressed, found one that is not: {error}; {REINDEX}"
            raise DataFormatError(self.path / METADATA, message) from None


def _open_folder(folder: Path) -> JoinedLog:
    """Open a folder with ``metadata.yaml``, or at least the files of one recording."""
    about = _metadata(folder)
    files = _files(folder, about)
    is_packed = str(about.get("compression_mode", "")).upper() == "MESSAGE"
    if is_packed and about.get("compression_format") != "zstd":
        message = f"messages are compressed with {str(about.get('compression_format'))[:40]!r}, expected zstd"
        raise DataFormatError(folder / METADATA, message)
    if not files:
        raise DataFormatError(folder, f"holds no {' or '.join(SUFFIXES)} file that can be read")
    with ExitStack() as opened:
        parts = [opened.enter_context(closing(open_log(file))) for file in files]
        return JoinedLog(folder, parts, opened.pop_all().close, is_packed=is_packed)


def _metadata(folder: Path) -> dict[str, Any]:
    """Read what ``metadata.yaml`` says of a bag; nothing where there is none."""
    path = folder / METADATA
    if not path.exists():
        return {}
    advice = f"{REINDEX}, or delete it to read the bag without it"
    about = mapping_in(read_yaml(path, read_bytes(path), f"; {advice}")).get("rosbag2_bagfile_information")
    if not isinstance(about, dict):
        raise DataFormatError(path, f"expected rosbag2_bagfile_information in it; {advice}")
    return about


def _files(folder: Path, about: dict[str, Any]) -> list[Path]:
    """Files of the recording in order; only names inside the folder are followed."""
    there = sorted(p.name for p in folder.iterdir() if p.is_file())
    present = [folder / name for name in there if Path(name).suffix in SUFFIXES]
    if packed := [name for name in there if name.endswith((".db3.zstd", ".mcap.zstd"))]:
        message = f"its files are compressed as a whole; decompress them first (unzstd {packed[0]})"
        raise DataFormatError(folder, message)
    named = about.get("relative_file_paths")
    if named is None:
        return present
    if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
        raise DataFormatError(folder / METADATA, "expected a list of names in relative_file_paths")
    if outside := [name for name in named if Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name]:
        raise DataFormatError(folder / METADATA, f"names a file outside the folder: {outside[0]!r}")
    names = list(dict.fromkeys(Path(name).name for name in named))  # old recorders wrote the folder in front
    if missing := [name for name in names if name not in there]:
        raise DataFormatError(folder / METADATA, f"names {missing[0]!r}, which is not in the folder; {REINDEX}")
    return [folder / name for name in names] or present
