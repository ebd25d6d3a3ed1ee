# SPDX-License-Identifier: BSD-3-Clause
"""Public recordings: where they are, what they may be used for, and how to get them, checksum-verified."""

import hashlib
import json
import logging
import re
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from magmatch.atomic import write_whole
from magmatch.data.tables.text import read_bytes
from magmatch.errors import ConfigurationError, DataFormatError, DatasetError

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """A public recording at one commit of a public repository."""

    name: str  # short name, also the folder its files are kept in
    title: str  # what was recorded, in one line
    citation: str  # what to cite
    licence: str  # what the files may be used for
    repository: str  # owner and name on GitHub
    commit: str  # 40 hex digits
    folder: str  # folder in the repository that holds the files
    # SHA-256 of each file, by its path below the folder (and below the local folder of the same name)
    files: dict[str, str]
    within: str = ""  # folder, beside the files' own folders in the repository, that they lie in there
    # Lines of a published text that are kept; the others are large and of no use here, or name a person. The SHA-256
    # is of those.
    kept: str = ""

    def url(self, file: str) -> str:
        """The address of one file."""
        place = Path(self.folder, file).parent / self.within / Path(file).name
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{place.as_posix()}"

    def content(self, path: Path) -> bytes:
        """The part of a file that is kept; the file may be packed (gzip)."""
        content = read_bytes(path)
        if not self.kept:
            return content
        line_is_kept = re.compile(self.kept.encode()).match
        return b"".join(line for line in content.splitlines(keepends=True) if line_is_kept(line))


_REGISTRY = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
DATASETS: dict[str, Dataset] = {name: Dataset(name, **facts) for name, facts in _REGISTRY.items()}


def find_dataset(name: str) -> Dataset:
    """Entry of a dataset; the error for an unknown name lists those that are known."""
    if name not in DATASETS:
        msg = f"unknown dataset '{name}', expected one of {', '.join(DATASETS)}"
        raise ConfigurationError(msg)
    return DATASETS[name]


def fetch(name: str, source_dir: str | Path | None = None) -> dict[str, Path]:
    """Bring a dataset's files into the cache, by download or from a local folder; gives the verified files by name.

    Files that are already there and whole are kept. The licence and the citation are logged before any download.
    """
    dataset, cache = find_dataset(name), cache_folder() / name
    logger.info("%s: %s. Licence: %s Cite: %s", name, dataset.title, dataset.licence, dataset.citation)
    sources = None if source_dir is None else verified_files(name, source_dir)
    files = {file: cache / file for file in dataset.files}
    for file, path in files.items():
        if not path.is_file() or _sha256(read_bytes(path)) != dataset.files[file]:
            content = _download(dataset, file) if sources is None else dataset.content(sources[file])
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)
    return files


def verified_files(name: str, source_dir: str | Path) -> dict[str, Path]:
    """Files of a dataset in a local folder (or one in it named after the dataset), each checked by its SHA-256."""
    dataset, source = find_dataset(name), Path(source_dir)
    folder = source / name if (source / name).is_dir() else source
    if not folder.is_dir():
        raise DataFormatError(source_dir, f"expected a folder that holds the files of dataset '{name}'")
    files: dict[str, Path] = {}
    for file, digest in dataset.files.items():
        path = folder / file
        if dataset.kept and not path.is_file():  # text, which may be packed
            path = path.with_name(f"{path.name}.gz")
        if not path.is_file():
            message = f"no such file, but dataset '{name}' needs it; get it from {dataset.url(file)}"
            raise DataFormatError(path, message)
        if (found := _sha256(dataset.content(path))) != digest:
            message = f"is not the published file: expected SHA-256 {digest[:12]}..., found {found[:12]}..."
            raise DataFormatError(path, message)
        files[file] = path
    return files


def cache_folder() -> Path:
    """Folder that downloaded datasets are kept in."""
    import pooch

    return Path(pooch.os_cache("magmatch"))


def _download(dataset: Dataset, file: str) -> bytes:
    """Content of a file of a dataset, verified."""
    import pooch

    pooch.get_logger().setLevel("WARNING")  # its progress lines go to stderr; what is fetched is logged here
    url, digest = dataset.url(file), dataset.files[file]
    try:
        with TemporaryDirectory(prefix="magmatch-") as folder:
            # What is kept is verified below, since all of a file may be published otherwise.
            known = None if dataset.kept else f"sha256:{digest}"
            kennel = pooch.create(folder, "", registry={file: known}, urls={file: url}, retry_if_failed=1)
            content = dataset.content(Path(kennel.fetch(file, downloader=pooch.HTTPDownloader(timeout=30))))
    except ValueError as error:  # pooch's word for a checksum that differs
        msg = f"dataset '{dataset.name}': {url} is not what was published: {' '.join(str(error).split())}"
        raise DatasetError(msg) from None
    except OSError as error:  # requests' errors are OSErrors
        advice = "Without a connection, copy its files into a folder and use --from FOLDER"
        msg = f"dataset '{dataset.name}': cannot download {url} ({_reason(error)}). {advice}"
        raise DatasetError(msg) from None
    if _sha256(content) != digest:
        msg = f"dataset '{dataset.name}': {url} is not what was published: its lines differ"
        raise DatasetError(msg)
    return content


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _reason(error: OSError) -> str:
    """Say in few words why a download failed: the full text of connection errors runs over many lines."""
    response = getattr(error, "response", None)
    if response is not None:
        return f"HTTP status {response.status_code}"
    if error.filename is not None and error.strerror:  # of the cache, not of the net
        return f"{error.strerror}: {error.filename}; XDG_CACHE_HOME names another folder"
    return type(error).__name__
