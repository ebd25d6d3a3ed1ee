# SPDX-License-Identifier: BSD-3-Clause
"""A folder of maps as the base, and the indexes beside maps."""

import json
import shutil

import pytest

from magmatch.registration.result import RegistrationResult


@pytest.fixture(scope="module")
def folder(place, tmp_path_factory):
    """Two maps: the base's, and the base's of another frame under a name that comes first."""
    folder = tmp_path_factory.mktemp("maps")
    shutil.copy(place / "base.map", folder / "office.map")
    (folder / "notes.txt").write_text("not a map\n")
    return folder


def test_register_finds_the_map_in_a_folder(place, folder, run, tmp_path):
    out, report = tmp_path / "r.json", tmp_path / "r.html"
    outcome = run("register", folder, place / "target.csv", "--out", out, "--report", report, "--json")
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out)["base"] == "office.map"
    assert RegistrationResult.load(out).base == "office.map"
    assert (folder / "office.map.index").is_file()
    assert report.stat().st_size > 10_000
    assert "office.map" in outcome.err


def test_index_is_written_once_and_again_for_another_map(place, run, tmp_path):
    path = tmp_path / "room.map"
    shutil.copy(place / "base.map", path)
    assert "Wrote" in run("index", path).err
    assert "up to date" in run("index", tmp_path).err
    first = (tmp_path / "room.map.index").read_bytes()
    shutil.copy(place / "target.map", path)
    assert "Wrote" in run("index", path).err
    assert (tmp_path / "room.map.index").read_bytes() != first


def test_with_and_without_index_the_answer_is_the_same(place, run, tmp_path):
    path = tmp_path / "room.map"
    shutil.copy(place / "base.map", path)
    without = json.loads(run("register", path, place / "target.map", "--json").out)
    run("index", path)
    assert json.loads(run("register", path, place / "target.map", "--json").out)["T_base_target"] == (
        without["T_base_target"]
    )


def test_a_folder_without_maps_is_refused_in_one_line(place, run, tmp_path):
    outcome = run("register", tmp_path, place / "target.csv")
    assert outcome.code == 2
    assert len(outcome.err.strip().splitlines()) == 1
    assert "folder" in outcome.err


def test_index_of_something_else_is_refused(place, run):
    outcome = run("index", place / "base.csv")
    assert outcome.code == 2
    assert "base.csv" in outcome.err
