# SPDX-License-Identifier: BSD-3-Clause
"""Public recordings: where they are, what they may be used for, and how to get them, checksum-verified."""

import hashlib
import logging
import re
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from magmatch.atomic import atomic_write
from magmatch.data.tables.text import read_bytes
from magmatch.errors import ConfigurationError, DataFormatError, DatasetError

logger = logging.getLogger(__name__)

_NO_LICENCE = (
    "No licence stated by its authors: you may evaluate on your own copy and publish derived numbers with the "
    "citation; do not redistribute the files."
)


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


DATASETS: dict[str, Dataset] = {
    dataset.name: dataset
    for dataset in (
        Dataset(
            name="kok",
            title="Hand-held tablet with visual-inertial poses: eight, square, library, mall (4.5 m to 49 x 68 m)",
            citation="M. Kok and A. Solin, Online One-Dimensional Magnetic Field SLAM with Loop-Closure Detection, "
            "IEEE International Conference on Multisensor Fusion and Integration (MFI), 2024",
            licence="MIT, Copyright (c) 2024 Manon Kok and Arno Solin",
            repository="manonkok/1d-magnetic-field-slam",
            commit="2cd608c6403d46c392a5c61d9bbf567861d7c2c4",
            folder="data",
            files={
                "eight.mat": "aff10eff4881443ec6685a752027d7cc0bfe95335de9a1009b97d86b3a5c0e48",
                "library.mat": "b5a5eca5e19a9e57cf3354c58eea74ac20fafaa678c0760b7888517b1b8e10fa",
                "mall.mat": "33911e38979560483aace207b816bc01cbd49b1f77e94fe241bef6ddb955a800",
                "square.mat": "c23aa2bad3fc904c680af050f016d2dcd325b93b52a4d1cf22fe07ff881949d1",
            },
        ),
        Dataset(
            name="cea",
            title="Two complete walks of a two-floor building in one frame (68 x 38 m, 32,209 samples)",
            citation="Abdul-Raouf et al., large-scale magnetic mapping, Conference on Robot Learning (CoRL), 2024",
            licence=_NO_LICENCE,
            repository="CEA-LIST/large-scale-magnetic-mapping",
            commit="a408b6173ff14ec7803c5a193f4ee62ddbf9faef",
            folder="corridor",
            files={
                "corridor_test.csv": "6a49bf02065689ba1e72e41078abdf94200a99e3704ec8b62d2ff8f73e55665d",
                "corridor_training.csv": "3804ff90585397a2687e867c2c0e23f58c7e66d4dbfe0d0e39b799e51d5ef098",
            },
        ),
        Dataset(
            name="aalto",
            title="Wheeled robot under motion capture, two magnetometers, runs 1, 2 and 4 (5 x 4 m)",
            citation="A. Solin, M. Kok, N. Wahlström, T. B. Schön and S. Särkkä, Modeling and Interpolation of the "
            "Ambient Magnetic Field by Gaussian Processes, IEEE Transactions on Robotics 34(4), 2018",
            licence=_NO_LICENCE,
            repository="AaltoML/magnetic-data",
            commit="b45da3bc7ab623fdef6e01247021daebf7983f29",
            folder="data",
            files={
                "invensense/1-loc.csv": "10af3f5bc4ec1777018c5e6d88302f2d73920b40f9e335ba1071672cac598b67",
                "invensense/1-mag.csv": "f6068d320ff4277b861a4572ce92bcf181c4e6087fea49ac68499b5974481c0a",
                "invensense/1-time.csv": "17a291e0fdd1f4ed284ca90025982deff3ed1a630a614795f2cf8f3b668ae0d2",
                "invensense/2-loc.csv": "3edc88dc5c16cffe01725aed2b4740689599a995239293594a39fd2999263909",
                "invensense/2-mag.csv": "77c2c3d7b133699b6bd1cac2e10210c83c8f258cfeeb6681bd2ef1cc6f92fe7e",
                "invensense/2-time.csv": "566362a68d0d5bbcfe07791f24532be2c32c3723e11bd0a301e204ef0f63f219",
                "invensense/4-loc.csv": "496cd49c36a45087f9443fe584dfc0d95e1339715a675f2a4113faa09fb831a5",
                "invensense/4-mag.csv": "c6154bb5eb63ebcf989cc42dbc0076292d330dc1a5ed8e80bac21b1ff1488702",
                "invensense/4-time.csv": "8282e3e1419ec55905e6d4eef9922ee72499f5f1ae941986cb89f0e79df033ee",
                "trivisio/1-loc.csv": "e1296365f5049386d195e94ddca16f72d1c7f31588734dad83f9858d52e7bad4",
                "trivisio/1-mag.csv": "99460736aaab8aa4e167146d74124853591b4e09954b9f1d7ae9641ce56d6bcf",
                "trivisio/1-time.csv": "9be545c3fd130a089ab989f5c6a3f9a738877cb5833f01be74d45f09905b654d",
                "trivisio/2-loc.csv": "195a1fa511b6fc42c79058902af4b5e2b48037b3974823c3b03e3ad1a5a1b660",
                "trivisio/2-mag.csv": "67cf901c158f98eb89740f8c3420829160ccbe28f3a5fa6c2ff5fd8bd3c3f074",
                "trivisio/2-time.csv": "f81f2572fa366cda2f9a9ddb6e368e9ae54d0490bd8e150c983f9152a3f3b992",
                "trivisio/4-loc.csv": "8ef5efdbdd652bfa5d4677b924b5a33eec1e33ee7b89073137b2d2c553a1bcab",
                "trivisio/4-mag.csv": "88808edc350cd1f30d2ef5340cd1bfadbfbe3ed6f0cf9c715c3f28f3836e201a",
                "trivisio/4-time.csv": "c29ff89397d64ea3b62fec5012b868bdf506a2a0df340aad35f6b6192b383d00",
            },
        ),
        Dataset(
            name="jidling",
            title="Hand-held sensor in a volume under motion capture (3.8 x 4.0 x 2.1 m, 100 Hz)",
            citation="C. Jidling, N. Wahlström, A. Wills and T. B. Schön, Linearly Constrained Gaussian Processes, "
            "Advances in Neural Information Processing Systems (NIPS), 2017",
            licence=_NO_LICENCE,
            repository="carji475/linearly-constrained-gaussian-processes",
            commit="6c7aba65c44fe54130877f0133f13d3b70ad2662",
            folder="real-data-experiment/study",
            files={"dataSet14.mat": "3e840880abce8a5898b9bb806ac87dd89b6aa98cd4daf3de6ae1f102d333b307"},
        ),
        Dataset(
            name="kaist",
            title="Phone survey of one building floor on a 0.6 m grid (one pass)",
            citation="S. Lee, Robust Magnetic Field Positioning (KAIST), software and maps, 2019",
            licence="MIT, Copyright (c) 2019 SangJae Lee",
            repository="canlang/sjlee-s-Robust-Magnetic-Field-Positionig",
            commit="3cc2e84f8b5f0e7eaef5fdef89d2a144c8c91768",
            folder="mats",
            files={"magmap-KI-1F-0.6p.mat": "f973dbd58c23bfdc05bddf930b940c41109499174e479bf562cd006d2b2db28d"},
        ),
        Dataset(
            name="xyz10",
            title="Phones' raw logs of ten walks of a mall's floor, with surveyed points (478 m, for slam)",
            citation="XYZ10 and Microsoft Research, Indoor Location Competition 2.0, sample data, 2020",
            licence="MIT, Copyright (c) 2017-2020 XYZ10, Inc.",
            repository="location-competition/indoor-location-competition-20",
            commit="8ab177cd7be2700442714b7d13fa452bedc685f5",
            folder="data/site1",
            within="path_data_files",
            kept=r"#\t(?!User:|DeviceId:)|\d+\tTYPE_(ACCELEROMETER|GYROSCOPE|MAGNETIC_FIELD(_UNCALIBRATED)?|"
            r"ROTATION_VECTOR|WAYPOINT)\t",
            files={
                "F2/5dda52109191710006b573b5.txt": "a2b7bfa87cc48a9183664af351adf9e4f53c8e996cd19af856b975ba8765ba8a",
                "F2/5dda5af79191710006b573ed.txt": "076e56b8fee409198b86d400c7374cd34f3da2197175fafb9d465218bb6cc322",
                "F2/5dda5b009191710006b573f3.txt": "83409c7b3a110dc84fa709b903b98cc1388f1ac9abdc068821b4d305a1a95551",
                "F2/5dda5b01c5b77e0006b1771f.txt": "952a320c7abb903122e25d758010595d2c4645000a09dc62320bb0e5bc8ab852",
                "F2/5dda5b02c5b77e0006b17721.txt": "fbc3fe1e17558a980f7098e2d03c184731d6c7d58382df2f440b4ef0228fd622",
                "F2/5dda5b039191710006b573f7.txt": "f91f79d7d6b40d91e0e1ae7fdd6811947702d127ba6f4e74d4aaf84351fac608",
                "F2/5dda5b04c5b77e0006b17723.txt": "3e4380fbdce44e4ee8543c4f4a2c8a05bc276275da577f0c1b0ec819f00363c8",
                "F2/5dda5b05c5b77e0006b17725.txt": "1df5d75f8bb091d55c0a7fdc73c7a16c3cbaa1a9b4d9ff2fbbba2ae3c1d4907c",
                "F2/5ddb9ae59191710006b57696.txt": "8a5eb1567ab3d63ac6ced2740576820976759f6c53cce9a58d02e28a3f5c3326",
                "F2/5ddb9ae6c5b77e0006b179d3.txt": "031444208b32a2ede2fd7d97cd2692dcfccb4132e81d6a1ac6086b30b3561c3c",
            },
        ),
    )
}


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
    dataset = find_dataset(name)
    cache = cache_folder() / name
    missing = [file for file, digest in dataset.files.items() if not _is_whole(cache / file, digest)]
    logger.info("%s: %s. Licence: %s Cite: %s", name, dataset.title, dataset.licence, dataset.citation)
    if source_dir is not None:
        sources = verified_files(name, source_dir)
        for file in missing:
            _keep(cache / file, dataset.content(sources[file]))
    elif missing:
        _download(dataset, missing, cache)
    return {file: cache / file for file in dataset.files}


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
            raise DataFormatError(
                path, f"no such file, but dataset '{name}' needs it; get it from {dataset.url(file)}"
            )
        found = hashlib.sha256(dataset.content(path)).hexdigest()
        if found != digest:
            message = f"is not the published file: expected SHA-256 {digest[:12]}..., found {found[:12]}..."
            raise DataFormatError(path, message)
        files[file] = path
    return files


def cache_folder() -> Path:
    """Folder that downloaded datasets are kept in."""
    import pooch

    return Path(pooch.os_cache("magmatch"))


def sha256(path: str | Path) -> str:
    """SHA-256 of a file's content, in hex."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _keep(path: Path, content: bytes) -> None:
    """Put a file into the cache."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as stream:
        stream.write(content)


def _is_whole(path: Path, digest: str) -> bool:
    """Whether a file is there with the content it should have."""
    return path.is_file() and sha256(path) == digest


def _download(dataset: Dataset, files: list[str], cache: Path) -> None:
    """Download files into the cache; each is verified before it takes its place."""
    import pooch

    pooch.get_logger().setLevel("WARNING")  # its progress lines go to stderr; what is fetched is logged here
    for file in files:
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
            msg = (
                f"dataset '{dataset.name}': cannot download {url} ({_reason(error)}). Without a connection, "
                f"copy its files into a folder and use --from FOLDER"
            )
            raise DatasetError(msg) from None
        if hashlib.sha256(content).hexdigest() != digest:
            msg = f"dataset '{dataset.name}': {url} is not what was published: its lines differ"
            raise DatasetError(msg)
        _keep(cache / file, content)


def _reason(error: Exception) -> str:
    """Say in few words why a download failed: the full text of connection errors runs over many lines."""
    response = getattr(error, "response", None)
    if response is not None:
        return f"HTTP status {response.status_code}"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:  # of the cache, not of the net
        return f"{error.strerror}: {error.filename}; XDG_CACHE_HOME names another folder"
    return type(error).__name__
