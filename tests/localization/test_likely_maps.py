# SPDX-License-Identifier: BSD-3-Clause
"""A body is found in the right map of a folder, and in none where its own is missing."""

import shutil
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from drifting import Place, drifting_walk
from magmatch.cli.commands.localize import tell
from magmatch.errors import DataFormatError
from magmatch.field.config import SPLINE
from magmatch.localization.belief import Belief
from magmatch.localization.kept_state import KINDS, SCHEMA, restored, state_of
from magmatch.localization.known_places import KnownPlaces, NotReadyError
from magmatch.store import dumps, loads


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maps of three places; the walks are of the second and of a fourth."""
    folder = tmp_path_factory.mktemp("maps")
    rng = np.random.default_rng(5)
    for k, name in enumerate(("attic", "cellar", "hall")):
        _, truth = drifting_walk(Place(40 + k), 40 + k, laps=3.0)
        field = Place(40 + k).field(truth) + 2e-7 * rng.standard_normal(truth.shape)
        mm.build_map(mm.Survey(truth, field, name=name), SPLINE).save(folder / f"{name}.map")
    return folder


def test_the_right_map_of_a_folder_is_named_and_the_pose_is_in_it(folder):
    log, truth = drifting_walk(Place(41), 51, laps=1.2, start=1.0)
    track = mm.localize(mm.open_atlas(folder), log, mm.LocalizerConfig(is_planar=True))
    result = track.result()
    assert result.map == "cellar.map"
    assert {s.map for s in result.segments} <= {None, "cellar.map"}
    assert result.maps["cellar.map"] > 0.99
    assert result.maps_in_words.startswith("cellar.map ")
    assert result.maps_in_words.endswith(", none of the maps 0.00")
    assert result.share > 0.7
    error = np.linalg.norm(track.poses.translation - truth[track.is_stated], axis=1)
    assert np.median(error) < 0.1


def test_a_walk_of_no_map_in_the_folder_is_nowhere(folder):
    log, _ = drifting_walk(Place(77), 52, laps=0.8)
    track = mm.localize(mm.open_atlas(folder), log, mm.LocalizerConfig(is_planar=True))
    assert not track.is_stated.any()
    assert sum(track.result().maps.values()) < 0.5
    assert "none of the maps" in tell(track.result())


class Aside:
    """A loader that works when it is told to."""

    def __init__(self):
        self.waiting = []

    def submit(self, do, *arguments):
        self.waiting.append((future := Future(), do, arguments))
        return future

    def work(self):
        for future, do, arguments in self.waiting:
            future.set_result(do(*arguments))
        self.waiting.clear()


def test_no_sample_waits_for_votes_or_for_a_map_that_is_made_ready_aside(folder, feed):
    log, truth = drifting_walk(Place(41), 51, laps=1.6, start=1.0)
    aside = Aside()
    known = KnownPlaces(mm.open_atlas(folder), aside)
    localizer = mm.Localizer(known, mm.LocalizerConfig(is_planar=True))
    third = len(log) // 3
    assert feed(localizer, log, slice(0, third))[-1].status == "searching"
    # Votes, once and not for every bin.
    assert len(aside.waiting) == 1
    for n in range(third, len(log)):
        aside.work()
        feed(localizer, log, slice(n, n + 1))
    now = localizer.estimate()
    assert now.map == "cellar.map"
    assert np.linalg.norm(now.T_map_body.translation - truth[-1]) < 0.3
    # No map is held for a body that stopped waiting for it.
    assert not known._making


def test_a_body_that_is_found_is_searched_for_no_more(folder, monkeypatch, feed):
    log, _ = drifting_walk(Place(41), 51, laps=1.2, start=1.0)
    known = KnownPlaces(mm.open_atlas(folder))
    localizer, at, searched = mm.Localizer(known, mm.LocalizerConfig(is_planar=True)), 0, []
    while not localizer.estimate().is_stated:
        feed(localizer, log, slice(at, at + 1))
        at += 1
    monkeypatch.setattr(Belief, "search", searched.append)
    while at < len(log) and feed(localizer, log, slice(at, at + 1))[-1].is_stated:
        at += 1
    assert at > len(log) // 2
    assert not searched


def test_maps_are_searched_in_turn_where_time_is_for_one(folder):
    log, _ = drifting_walk(Place(41), 51, laps=1.0, start=1.0)
    localizer, turns = mm.Localizer(mm.open_atlas(folder), mm.LocalizerConfig(is_planar=True)), []

    def once():
        turns.append(len(turns))
        return len(turns) == 1

    R = log.orientations
    poses, field = RigidTransform.from_components(log.positions, R), R.inv().apply(log.field)
    for t, T, z in zip(log.times.tolist(), poses.as_matrix(), field, strict=True):
        turns.clear()
        localizer.update_by_matrix(t, T, z, may_search=once)
    assert localizer.estimate().map == "cellar.map"


def test_a_map_that_was_replaced_is_not_taken_for_the_one_that_was_indexed(folder, tmp_path, feed):
    for path in folder.iterdir():
        shutil.copy(path, tmp_path)
    log, _ = drifting_walk(Place(41), 51, laps=1.0, start=1.0)
    aside = ThreadPoolExecutor(1)
    seen, alone = KnownPlaces(mm.open_atlas(tmp_path), aside), KnownPlaces(mm.open_atlas(tmp_path))
    shutil.copy(tmp_path / "hall.map", tmp_path / "new")
    (tmp_path / "new").replace(tmp_path / "cellar.map")
    entry = next(entry for entry in alone.entries if entry.name == "cellar.map")
    with pytest.raises(DataFormatError, match=r"cellar\.map.* was replaced"):
        alone.of(entry)
    # Who walks on is not told: the other maps are searched, and this one once it is opened anew.
    localizer = mm.Localizer(seen, mm.LocalizerConfig(is_planar=True))
    feed(localizer, log)
    assert not localizer.estimate().is_stated
    aside.shutdown()


def test_a_state_is_resumed_once_its_maps_are_ready(folder, feed):
    log, _ = drifting_walk(Place(41), 51, laps=1.2, start=1.0)
    config = mm.LocalizerConfig(is_planar=True)
    one = mm.Localizer(KnownPlaces(mm.open_atlas(folder)), config)
    feed(one, log)
    aside = Aside()
    known, state = KnownPlaces(mm.open_atlas(folder), aside), dumps(SCHEMA, state_of(one))
    with pytest.raises(NotReadyError):
        restored(known, config, loads(state, SCHEMA, KINDS))
    aside.work()
    again = restored(known, config, loads(state, SCHEMA, KINDS)).estimate()
    np.testing.assert_array_equal(again.matrix, one.estimate().matrix)
