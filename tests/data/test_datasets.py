# SPDX-License-Identifier: BSD-3-Clause
"""Public recordings: only whole, verified files are used; what stands in the way is said in one line."""

import gzip
import hashlib
import logging
import sys
from dataclasses import replace

import numpy as np
import pooch
import pytest
import requests

from magmatch.data import datasets
from magmatch.data.checks import check_survey
from magmatch.data.datasets import DATASETS, Dataset, fetch
from magmatch.data.recordings import load_recordings
from magmatch.errors import ConfigurationError, DataFormatError, DatasetError, MissingExtraError

CONTENT = {"a.csv": b"1,2,3\n", "run/b.csv": b"4,5,6\n"}


@pytest.fixture
def toy(monkeypatch, tmp_path):
    """A data set of two tiny files in the table, and an empty cache."""
    digests = {file: hashlib.sha256(content).hexdigest() for file, content in CONTENT.items()}
    entry = Dataset("toy", "Two files", "Nobody, 2024", "MIT", "owner/repo", "c" * 40, "data", digests)
    monkeypatch.setitem(DATASETS, "toy", entry)
    monkeypatch.setattr(datasets, "cache_folder", lambda: tmp_path / "cache")
    return entry


@pytest.fixture
def source(tmp_path):
    """A folder with the toy's files."""
    for file, content in CONTENT.items():
        path = tmp_path / "source" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return tmp_path / "source"


class Web:
    """Stands in for the network: answers with what it is told to, and counts."""

    def __init__(self, answer):
        self.answer, self.urls = answer, []

    def __call__(self, url, output_file, _pooch):
        self.urls.append(url)
        if isinstance(self.answer, Exception):
            raise self.answer
        with open(output_file, "wb") as stream:  # noqa: PTH123  (pooch hands over a name)
            stream.write(self.answer[url.split("/data/")[1]])


@pytest.fixture
def web(monkeypatch):
    def install(answer):
        stand_in = Web(answer)
        monkeypatch.setattr(pooch, "HTTPDownloader", lambda **_: stand_in)
        monkeypatch.setattr("time.sleep", lambda _seconds: None)
        return stand_in

    return install


def test_download_fills_the_cache_once(toy, web):
    network = web(CONTENT)
    files = fetch("toy")
    assert {file: path.read_bytes() for file, path in files.items()} == CONTENT
    assert network.urls == [toy.url(file) for file in CONTENT]
    assert fetch("toy") == files
    assert len(network.urls) == len(CONTENT)


def test_licence_and_citation_are_logged_before_the_download(toy, web, caplog):
    web(requests.exceptions.ConnectionError("down"))
    with caplog.at_level(logging.INFO, logger="magmatch"), pytest.raises(DatasetError):
        fetch("toy")
    assert "Licence: MIT Cite: Nobody, 2024" in caplog.text


@pytest.mark.parametrize(
    "error", [requests.exceptions.ConnectionError("long\ntext"), requests.exceptions.ReadTimeout(), OSError("reset")]
)
def test_no_connection_is_one_line_with_a_way_out(toy, web, error):
    web(error)
    with pytest.raises(DatasetError, match=r"cannot download https.*--from FOLDER") as caught:
        fetch("toy")
    assert "\n" not in str(caught.value)


def test_download_that_differs_from_what_was_published_is_refused(toy, web, tmp_path):
    web(dict.fromkeys(CONTENT, b"another"))
    with pytest.raises(DatasetError, match="not what was published"):
        fetch("toy")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_damaged_file_in_the_cache_is_brought_again(toy, web):
    network = web(CONTENT)
    files = fetch("toy")
    files["a.csv"].write_bytes(b"damaged")
    fetch("toy")
    assert files["a.csv"].read_bytes() == CONTENT["a.csv"]
    assert network.urls[-1] == toy.url("a.csv")


@pytest.mark.parametrize("is_parent", [False, True])
def test_local_folder_fills_the_cache_without_a_connection(toy, web, source, tmp_path, is_parent):
    network = web(requests.exceptions.ConnectionError())
    folder = source.rename(tmp_path / "toy").parent if is_parent else source
    files = fetch("toy", folder)
    assert {file: path.read_bytes() for file, path in files.items()} == CONTENT
    assert fetch("toy") == files
    assert network.urls == []


def test_local_folder_that_lacks_a_file_is_named(toy, source):
    (source / "run/b.csv").unlink()
    with pytest.raises(DataFormatError, match=r"run/b\.csv: no such file.*https://raw"):
        fetch("toy", source)


def test_local_file_of_another_version_is_named(toy, source):
    (source / "a.csv").write_bytes(b"edited")
    with pytest.raises(DataFormatError, match=r"a\.csv: is not the published file: expected SHA-256 .*, found"):
        fetch("toy", source)


PUBLISHED = b"#\tUser:1234\n#\tBrand:OPPO\n1\tTYPE_WIFI\tx\n2\tTYPE_WAYPOINT\t3\t4\n"


@pytest.fixture
def lines(toy, monkeypatch):
    """A data set of which only some lines are kept, in a folder of its own in the repository."""
    digest = hashlib.sha256(b"#\tBrand:OPPO\n2\tTYPE_WAYPOINT\t3\t4\n").hexdigest()
    entry = replace(toy, files={"F2/a.txt": digest}, within="paths", kept=DATASETS["xyz10"].kept)
    monkeypatch.setitem(DATASETS, "toy", entry)
    return entry


def test_of_published_lines_those_are_kept_that_are_read_and_name_nobody(lines, web):
    network = web({"F2/paths/a.txt": PUBLISHED})
    (file,) = fetch("toy").values()
    assert file.read_bytes().splitlines() == [b"#\tBrand:OPPO", b"2\tTYPE_WAYPOINT\t3\t4"]
    assert network.urls == [f"https://raw.githubusercontent.com/owner/repo/{'c' * 40}/data/F2/paths/a.txt"]
    web({"F2/paths/a.txt": PUBLISHED.replace(b"4", b"5")})
    file.unlink()
    with pytest.raises(DatasetError, match="its lines differ"):
        fetch("toy")
    assert not file.exists()


@pytest.mark.parametrize("is_packed", [False, True])
def test_a_local_copy_may_be_packed_and_hold_all_lines(lines, web, tmp_path, is_packed):
    web(requests.exceptions.ConnectionError())
    place = tmp_path / "toy" / "F2" / ("a.txt.gz" if is_packed else "a.txt")
    place.parent.mkdir(parents=True)
    place.write_bytes(gzip.compress(PUBLISHED) if is_packed else PUBLISHED)
    (file,) = fetch("toy", tmp_path).values()
    assert b"WIFI" not in file.read_bytes()
    with pytest.raises(DataFormatError, match="nowhere: expected a folder"):
        fetch("toy", tmp_path / "nowhere")


def test_unknown_dataset_names_the_known_ones():
    with pytest.raises(ConfigurationError, match="unknown dataset 'cae', expected one of kok, cea, aalto"):
        fetch("cae")


RECORDINGS = {
    "kok": {"eight": 466, "square": 747, "library": 1435, "mall": 2575},
    "cea": {"training": 15575, "test": 16634, "training-floor1": 7015, "training-floor2": 7954,
            "test-floor1": 7444, "test-floor2": 9089},
    "aalto": {"invensense-1": 8875, "invensense-2": 9105, "invensense-4": 7332,
              "trivisio-1": 17612, "trivisio-2": 18109, "trivisio-4": 14597},
    "jidling": {"volume": 16782},
    "kaist": {"floor": 2337},
}  # fmt: skip


@pytest.mark.parametrize("name", RECORDINGS)
def test_real_recordings_load_as_plausible_surveys(name, recordings):
    surveys = load_recordings(name, recordings)
    assert {key: len(survey) for key, survey in surveys.items()} == RECORDINGS[name]
    for survey in surveys.values():
        doubts = [w for w in check_survey(survey) if "one plane" not in w]
        assert doubts == []
        assert 40e-6 < np.median(np.linalg.norm(survey.field, axis=1)) < 56e-6


def test_hdf5_recording_without_its_extra_names_the_extra(recordings, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[datasets\]'"):
        load_recordings("kaist", recordings)
