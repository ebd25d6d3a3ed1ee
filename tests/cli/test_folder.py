# SPDX-License-Identifier: BSD-3-Clause
"""A folder of maps as the base, and the indexes beside maps."""

import json
import shutil

import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.field.map import FieldMap
from magmatch.field.saved_map import MapFile
from magmatch.registration.index.map_index import index_path, open_index, prepare_index
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


def said(outcome):
    found = json.loads(outcome.out)
    return [found[name] for name in ("T_base_target", "covariance", "probability")]


def test_what_a_registration_prepared_is_kept_beside_the_map_for_the_next(place, run, tmp_path, monkeypatch):
    path, kept = tmp_path / "room.map", tmp_path / "room.map.index"
    shutil.copy(place / "base.map", path)
    words = ("register", path, place / "target.map", "--json")
    without = run(*words, "--no-keep-index")
    assert not kept.exists()
    first = run(*words)
    content = kept.read_bytes()
    assert "index" not in first.err
    monkeypatch.setattr("magmatch.registration.index.map_index.prepare", None)
    second = run(*words)
    assert kept.read_bytes() == content
    assert said(first) == said(second) == said(without)
    monkeypatch.undo()
    # Another map under the same name has nothing of it.
    shutil.copy(place / "target.map", path)
    run("register", path, place / "base.map", "--json")
    assert kept.read_bytes() != content


def test_where_nothing_can_be_kept_the_answer_is_the_same(place, run, tmp_path):
    path = tmp_path / "room.map"
    shutil.copy(place / "base.map", path)
    (tmp_path / "room.map.index").mkdir()  # nothing can be written under this name
    outcome = run("register", path, place / "target.map", "--json")
    assert outcome.code == 0, outcome.err
    assert "cannot" not in outcome.err
    assert "index" not in outcome.err
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["room.map"]


def test_nothing_is_kept_of_a_map_that_changed_meanwhile_or_was_made_of_one(place, tmp_path):
    path = tmp_path / "room.map"
    shutil.copy(place / "base.map", path)
    read = FieldMap.load(path)
    shutil.copy(place / "target.map", path)
    prepare_index(read)
    prepare_index(FieldMap.load(path).transformed(RigidTransform.from_translation([1, 2, 3])))
    assert not index_path(path).exists()
    shutil.copy(place / "base.map", path)
    prepare_index(read)
    assert not open_index(MapFile.of(path)).is_whole


def test_a_rough_pose_of_a_result_is_taken_and_kept_in_the_settings(place, run):
    words = ("register", place / "base.map", place / "target.map", "--json")
    outcome = run(*words, "--prior-pose", place / "result.json", "--prior-pose-sd", "0.5,20", "--gravity-aligned")
    assert outcome.code == 0, outcome.err
    prior = json.loads(outcome.out)["config"]["prior"]
    assert prior["sd_translation"] == 0.5
    assert prior["is_gravity_aligned"]
    assert prior["pose"][:3] == [
        row[3] for row in json.loads((place / "result.json").read_text())["T_base_target"][:3]
    ]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--prior-pose", "1,2,3"), "--prior-pose"),
        (("--prior-pose", "0,0,0,1,1,0,0"), "unit quaternion"),
        (("--prior-pose", "nothing.json"), "nothing.json"),
        (("--prior-pose", "0,0,0,0,0,0,1", "--prior-pose-sd", "1"), "--prior-pose-sd"),
        (("--prior-pose", "0,0,0,0,0,0,1", "--prior-pose-sd", "0,10"), "above 0"),
        (("--prior-pose-sd", "1,10"), "--prior-pose"),
        (("--gravity-sd", "1"), "--gravity-aligned"),
        (("--gravity-aligned", "--preset", "paper"), "keypoints"),
    ],
)
def test_priors_that_say_nothing_are_refused_in_one_line(place, refused, words, named):
    refused(["register", place / "base.map", place / "target.map", *words], named)


def test_what_may_differ_between_the_sensors_is_as_asked(place, run):
    words = ("register", place / "base.map", place / "target.map", "--json", "--sensor")
    found = {mode: json.loads(run(*words, mode).out)["sensor"] for mode in ("none", "full")}
    assert found["none"] is None
    assert len({round(number, 9) for row in found["full"]["gain"] for number in row}) > 3
