import shutil
from zipfile import ZipFile

import numpy as np
import pytest

import magmatch as mm
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.saved_map import MapFile
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.config import PRESETS
from magmatch.registration.index.atlas import is_atlas, open_atlas
from magmatch.registration.index.map_index import index_path, open_index
from magmatch.registration.register import register, register_keeping_maps
from magmatch.registration.weigh.bending_walk import BendingWalk
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.corruption import corrupt, draw_corruption
from magmatch.simulation.simulate import simulate
from magmatch.store import save

T_ROOM_WALK = random_transform(np.random.default_rng(1))


@pytest.fixture(scope="module")
def atlas(rooms):
    return open_atlas(rooms[0])


@pytest.fixture(scope="module")
def found_in_hall(atlas, walk_in):
    """A walk in the hall, in a frame of its own, and the answer for it."""
    target = walk_in("hall.map", np.random.default_rng(4)).transformed(T_ROOM_WALK.inv())
    return target, register(atlas, target)


def copy_map(source, goal):
    """Copy a map with its index, which is bound to the content and not to the name."""
    shutil.copy(source, goal)
    shutil.copy(index_path(source), index_path(goal))


def test_a_walk_is_found_in_its_own_room(found_in_hall):
    target, result = found_in_hall
    assert (result.base, result.is_accepted) == ("hall.map", True), result.reason
    distance, angle = transform_error(result.T_base_target, T_ROOM_WALK, target.centroid)
    assert distance < 0.05
    assert np.degrees(angle) < 3


def test_a_survey_of_a_room_is_found_in_its_own_map(atlas, rooms):
    pair, T_map_base, _ = rooms[1]["hall.map"]
    result = register(atlas, pair.target)
    assert (result.base, result.is_accepted) == ("hall.map", True), result.reason
    distance, angle = transform_error(result.T_base_target, T_map_base * pair.T_base_target, pair.target.centroid)
    assert distance < 0.02
    assert np.degrees(angle) < 1


@pytest.mark.slow
def test_where_only_the_likeliest_map_is_asked_for_poses_it_is_the_right_one(
    atlas, rooms, found_in_hall, monkeypatch
):
    survey = rooms[1]["cellar.map"][0].target
    asked_all = [found_in_hall, (survey, register(atlas, survey))]
    # Then no other map is searched, and a walk is binned by that one's length.
    for name in ("MAX_ASKED", "N_CANDIDATES"):
        monkeypatch.setattr(f"magmatch.registration.search.retrieval.{name}", 1)
    for target, expected in asked_all:
        found = register(atlas, target)
        assert (found.base, found.is_accepted) == (expected.base, True)
        # Other bins have other means.
        np.testing.assert_allclose(
            found.T_base_target.as_matrix(), expected.T_base_target.as_matrix(), rtol=0, atol=1e-3
        )


def test_without_its_own_room_a_walk_is_refused(atlas, walk_in, tmp_path):
    for name in ("attic.map", "hall.map"):
        copy_map(atlas.folder / name, tmp_path / name)
    result = register(open_atlas(tmp_path), walk_in("cellar.map", np.random.default_rng(2)))
    assert not result.is_accepted
    assert result.T_base_target is None


def test_maps_in_which_nothing_could_match_cost_no_bending(atlas, found_in_hall, monkeypatch):
    bent, weigh = [], BendingWalk.weigh

    def counted(bending, likely):
        bent.append(bending.base.field_map.file.path.name)
        return weigh(bending, likely)

    monkeypatch.setattr(BendingWalk, "weigh", counted)
    walk, expected = found_in_hall
    again = register(atlas, walk)
    assert set(bent) <= {"hall.map"}
    assert again.probability == expected.probability
    # A map that is asked alone is all that there is.
    assert not register(mm.FieldMap.load(atlas.folder / "attic.map"), walk).is_accepted
    assert bent[-1] == "attic.map"


def test_two_maps_of_one_room_are_ambiguous_and_both_are_named(atlas, walk_in, tmp_path):
    for name in ("one.map", "two.map"):
        copy_map(atlas.folder / "attic.map", tmp_path / name)
    result = register(open_atlas(tmp_path), walk_in("attic.map", np.random.default_rng(3)))
    assert result.status == "ambiguous"
    named = [a.base or result.base for a in result.alternatives]
    assert {"one.map", "two.map"} <= set(named)
    assert "in one.map and in two.map" in result.reason or "in two.map and in one.map" in result.reason
    assert "magmatch merge" in result.reason


def test_what_is_no_folder_of_maps_and_a_method_that_takes_none_are_refused(atlas, rooms):
    target = rooms[1]["hall.map"][0].target
    with pytest.raises(ConfigurationError, match="open_atlas"):
        mm.register(atlas, target, PRESETS["paper"])
    with pytest.raises(TypeError, match="open_atlas"):
        mm.register(rooms[0] / "none", target)


@pytest.mark.parametrize("kind", [pytest.param("walk", marks=pytest.mark.slow), "survey"])
def test_a_folder_that_holds_one_map_answers_as_that_map_does(atlas, rooms, walk_in, tmp_path, kind):
    copy_map(atlas.folder / "hall.map", tmp_path / "hall.map")
    field_map = mm.FieldMap.load(tmp_path / "hall.map")
    is_walk = kind == "walk"
    target = walk_in("hall.map", np.random.default_rng(7)) if is_walk else rooms[1]["hall.map"][0].target
    alone, among = (mm.register(base, target).to_dict() for base in (field_map, str(tmp_path)))
    assert (alone.pop("base"), among.pop("base")) == (None, "hall.map")
    for one in (alone, among):
        del one["seconds"]
    assert among == alone


def test_an_index_of_another_map_is_stale(atlas, tmp_path):
    path = tmp_path / "a.map"
    shutil.copy(atlas.folder / "attic.map", path)
    assert open_index(MapFile.of(path)) is None
    copy_map(atlas.folder / "attic.map", path)
    assert open_index(MapFile.of(path)) is not None
    shutil.copy(atlas.folder / "hall.map", path)
    assert open_index(MapFile.of(path)) is None


def test_a_damaged_index_is_made_again(atlas, walk_in, tmp_path):
    copy_map(atlas.folder / "attic.map", tmp_path / "attic.map")
    place = index_path(tmp_path / "attic.map")
    content = bytearray(place.read_bytes())
    content[-2000] ^= 1
    place.write_bytes(content)
    result = register(open_atlas(tmp_path), walk_in("attic.map", np.random.default_rng(5)))
    assert result.is_accepted, result.reason
    open_index(MapFile.of(tmp_path / "attic.map")).stored.check()


def test_what_else_is_kept_in_a_folder_is_no_map(atlas, tmp_path):
    copy_map(atlas.folder / "attic.map", tmp_path / "attic.map")
    save(tmp_path / "session.state", "magmatch.slam.session/9", {})
    (tmp_path / "attic.map.old").write_bytes(index_path(tmp_path / "attic.map").read_bytes())
    for name in ("photos.zip", "plan.xlsx", "grid.npz"):
        with ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("[Content_Types].xml" if name == "plan.xlsx" else "image.jpg", "x")
    assert [entry.name for entry in open_atlas(tmp_path).entries] == ["attic.map"]


def test_a_folder_without_maps_is_no_atlas(tmp_path):
    Survey(np.zeros((3, 3)), np.ones((3, 3))).save(tmp_path / "survey.csv")
    assert not is_atlas(tmp_path)
    with pytest.raises(DataFormatError, match="holds no saved maps"):
        open_atlas(tmp_path)
    with pytest.raises(DataFormatError, match="cannot be read"):
        open_atlas(tmp_path / "nowhere")
    file = tmp_path / "base.csv"
    file.touch()
    with pytest.raises(DataFormatError, match="expected a folder of saved maps"):
        open_atlas(file)


@pytest.mark.slow
def test_a_raw_log_is_found_once_its_sensor_is_calibrated(tmp_path):
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    config = SimulationConfig(n_samples=1000, room_size=(2.0, 2.0, 0.6))
    pair, elsewhere = (simulate("office-hand-held", seed, config) for seed in (41, 42))
    for name, survey in (("here", pair.base), ("elsewhere", elsewhere.base)):
        build_map(survey, SPLINE).save(tmp_path / f"{name}.map")
    rng = np.random.default_rng(41)
    raw = corrupt(pair.target, draw_corruption(rng), rng)[0]
    _, used, result = register_keeping_maps(open_atlas(tmp_path), raw)
    assert (result.is_accepted, result.base) == (True, "here.map")
    assert transform_error(result.T_base_target, pair.T_base_target, pair.target.centroid)[0] < 8e-3
    assert "target" in result.sensor["calibrated"]
    assert not np.array_equal(used.survey.field[:100], raw.field[:100])
