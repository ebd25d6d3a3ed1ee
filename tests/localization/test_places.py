# SPDX-License-Identifier: BSD-3-Clause
"""A body is found in the right map of a folder, and in none where its own is missing."""

from concurrent.futures import Future

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from drifting import Place, drifting_walk
from magmatch.localization.known_places import KnownPlaces


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maps of three places; the walks are of the second and of a fourth."""
    folder = tmp_path_factory.mktemp("maps")
    rng = np.random.default_rng(5)
    for k, name in enumerate(("attic", "cellar", "hall")):
        _, truth = drifting_walk(Place(40 + k), 40 + k, laps=3.0)
        field = Place(40 + k).field(truth) + 2e-7 * rng.standard_normal(truth.shape)
        mm.build_map(mm.Survey(truth, field, name=name)).save(folder / f"{name}.map")
    return folder


def test_the_right_map_of_a_folder_is_named_and_the_pose_is_in_it(folder):
    log, truth = drifting_walk(Place(41), 51, laps=1.2, start=1.0)
    track = mm.localize(mm.open_atlas(folder), log, mm.LocalizerConfig(is_planar=True))
    result = track.result()
    assert result.map == "cellar.map"
    assert {s.map for s in result.segments} <= {None, "cellar.map"}
    assert result.share > 0.7
    error = np.linalg.norm(track.poses.translation - truth[track.is_stated], axis=1)
    assert np.median(error) < 0.1


def test_a_walk_of_no_map_in_the_folder_is_nowhere(folder):
    log, _ = drifting_walk(Place(77), 52, laps=1.2)
    track = mm.localize(mm.open_atlas(folder), log, mm.LocalizerConfig(is_planar=True))
    assert not track.is_stated.any()


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


def test_no_sample_waits_for_votes_or_for_a_map_that_is_made_ready_aside(folder):
    log, truth = drifting_walk(Place(41), 51, laps=1.6, start=1.0)
    aside = Aside()
    known = KnownPlaces(mm.open_atlas(folder), aside)
    localizer = mm.Localizer(known, mm.LocalizerConfig(is_planar=True))
    poses, field = (
        RigidTransform.from_components(log.positions, log.orientations),
        log.orientations.inv().apply(log.field),
    )
    for n, t in enumerate(log.times):
        localizer.update(float(t), poses[n], field[n])
        if n == len(log) // 3:
            # Votes, once and not for every bin.
            assert len(aside.waiting) == 1
            assert localizer.estimate().status == "searching"
        if n >= len(log) // 3:
            aside.work()
    now = localizer.estimate()
    assert now.map == "cellar.map"
    assert np.linalg.norm(now.T_map_body.translation - truth[-1]) < 0.3
    # No map is held for a body that stopped waiting for it.
    assert not known._making


def test_a_rigid_survey_is_still_registered_to_an_atlas(folder):
    _, truth = drifting_walk(Place(42), 53, laps=0.6)
    result = mm.localize(mm.open_atlas(folder), mm.Survey(truth, Place(42).field(truth)))
    assert isinstance(result, mm.RegistrationResult)
    assert result.base in ("hall.map", None)
