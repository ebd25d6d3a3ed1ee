# SPDX-License-Identifier: BSD-3-Clause
"""What is written of a track is what was known, at the times it was known for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm


def test_poses_are_written_at_their_times_those_between_the_samples_too(followed, tmp_path):
    log, track = followed.log, followed.track
    middle = (log.times[:-1] + log.times[1:]) / 2
    track.save(tmp_path / "own.tum")
    np.testing.assert_array_equal(mm.Trajectory.load(tmp_path / "own.tum").positions, track.poses.translation)
    track.save(tmp_path / "where.tum", mm.Trajectory(log.times, log.positions, log.orientations))
    whole = mm.Trajectory.load(tmp_path / "where.tum")
    np.testing.assert_array_equal(whole.times, log.times[track.is_stated])
    np.testing.assert_allclose(whole.positions, track.poses.translation, atol=1e-12)
    positions, R = mm.Trajectory(log.times, log.positions, log.orientations).interpolate(middle)
    track.save(tmp_path / "between.tum", mm.Trajectory(middle, positions, R))
    between = mm.Trajectory.load(tmp_path / "between.tum")
    np.testing.assert_array_equal(between.times, middle[track.is_stated[:-1]])
    p, _ = whole.interpolate(between.times[:-1])
    assert np.median(np.linalg.norm(between.positions[:-1] - p, axis=1)) < 0.02


def test_the_result_reads_back_as_it_was_written(followed, tmp_path):
    result = followed.track.result()
    result.save(tmp_path / "result.json")
    assert mm.LocalizationResult.load(tmp_path / "result.json").to_dict() == result.to_dict()
    assert result.first_fix[0] == followed.log.times[np.argmax(followed.track.is_stated)]
    assert result.segments[0].t0 == followed.log.times[0]
    assert result.segments[-1].t1 == followed.log.times[-1]


@pytest.fixture
def nowhere(followed):
    """The walk as if it had never been found."""
    return replace(followed.track, estimates=[replace(e, matrix=None) for e in followed.track.estimates])


def test_a_log_that_is_never_found_says_first_what_is_wrong_with_it(nowhere):
    unturned = replace(nowhere.log, field=nowhere.log.orientations.inv().apply(nowhere.log.field))
    wrong, last = replace(nowhere, log=unturned).result(), nowhere.estimates[-1]
    assert wrong.reason.startswith("the field vectors look like those of a sensor that turns")
    assert wrong.reason.endswith(last.reason)
    assert nowhere.result().reason == last.reason


def test_a_log_whose_z_is_evidently_not_up_is_told_so_where_it_is_never_found(nowhere):
    lying = nowhere.log.transformed(RigidTransform.from_rotation(Rotation.from_euler("x", 90, degrees=True)))
    lying = replace(nowhere, log=lying)
    said = lying.result().reason
    assert "below the map's horizontal and" in said
    assert "--no-gravity" in said
    free = replace(lying, config=nowhere.config.model_copy(update={"is_gravity_aligned": False}))
    assert "--no-gravity" not in free.result().reason


def test_a_dead_reckoned_log_that_is_never_found_is_told_how_the_phone_has_to_be_held(nowhere):
    held = "dead reckoning takes the phone's upper end to point forward"
    assert held not in nowhere.result().reason
    reckoned = replace(nowhere, log=replace(nowhere.log, is_dead_reckoned=True))
    assert reckoned.result().reason.endswith(f"; {held}")
    # A body that has not moved was not looked for.
    still = replace(reckoned, estimates=[replace(e, probability=0.0) for e in reckoned.estimates])
    assert held not in still.result().reason
