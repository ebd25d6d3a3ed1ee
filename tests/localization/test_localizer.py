# SPDX-License-Identifier: BSD-3-Clause
"""A body is found in its map from an unknown start, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from drifting import Place, about_z, drifting_walk, loop
from magmatch.field.config import SPLINE
from magmatch.localization.localizer import FOUND_ELSEWHERE
from magmatch.localization.samples import OdometryJump


def test_a_walk_from_an_unknown_start_is_found_and_followed(followed):
    is_stated = followed.track.is_stated
    first = int(np.argmax(is_stated))
    assert is_stated[first:].mean() > 0.9
    error = np.linalg.norm(followed.track.poses.translation - followed.truth[is_stated], axis=1)
    # The map's field length is 0.6 m.
    assert np.median(error) < 0.1
    assert error.max() < 0.6


def test_the_sensors_bias_and_the_odometrys_scale_are_found(followed):
    result = followed.track.result()
    assert "the body has moved too little" in result.segments[0].why
    np.testing.assert_allclose(result.sensor["bias"], [2e-6, -1e-6, 1e-6], atol=4e-7)
    assert result.odometry["scale"] == pytest.approx(1 / 1.01, abs=0.01)


@pytest.mark.parametrize(("turn", "seed"), [(0.2, 2), (4.0, 2)])
def test_how_the_odometry_drifts_is_learned_from_the_path(place, turn, seed):
    """It is stated to turn by 2 degrees in 10 m: by 0.6 in one."""
    log, _ = drifting_walk(Place(1), seed, laps=1.5, turn=turn)
    sd = mm.localize(place, log).result().odometry["sd"]
    assert (sd[1] > 4) if turn > 1 else (sd[1] <= 2)
    assert sd[0] / sd[1] == pytest.approx(0.15 / 2)


def test_the_gain_of_the_sensor_is_found_too(place, followed):
    louder = replace(followed.log, field=1.015 * followed.log.field)
    gains = [mm.localize(place, log).result().sensor["scale"] for log in (followed.log, louder)]
    # Earth's field tells it from a bias only as far as the body turns and the field changes.
    assert gains[1] / gains[0] == pytest.approx(1.015, abs=0.005)


def test_the_stated_covariance_covers_the_error(followed):
    stated = [(e, p) for e, p in zip(followed.track.estimates, followed.truth, strict=True) if e.is_stated]
    local = [e.T_map_body.inv().apply(p) for e, p in stated]
    nees = [x @ np.linalg.solve(e.covariance[3:, 3:], x) / 3 for x, (e, _) in zip(local, stated, strict=True)]
    # One walk of correlated errors: within a factor of a few.
    assert 0.1 < np.mean(nees) < 4


def test_the_odometrys_frame_does_not_matter(place, followed):
    T = RigidTransform.from_components([30.0, -20.0, 0.0], Rotation.from_rotvec([0, 0, 2.0]))
    again = mm.localize(place, followed.log.transformed(T), live=True)
    both = followed.track.is_stated & again.is_stated
    assert both.sum() > 0.95 * followed.track.is_stated.sum()
    a, b = ([e.matrix for e, s in zip(t.estimates, both, strict=True) if s] for t in (followed.track, again))
    assert np.median(np.linalg.norm(np.subtract(a, b)[:, :3, 3], axis=1)) < 0.02


def test_with_nothing_known_of_the_odometrys_frame_the_walk_is_found_too(place, followed):
    T = RigidTransform.from_components([3.0, 8.0, -2.0], Rotation.from_rotvec([1.0, -2.0, 0.5]))
    track = mm.localize(place, followed.log.transformed(T), mm.LocalizerConfig(is_gravity_aligned=False))
    is_stated = track.is_stated
    assert is_stated.mean() > 0.6
    error = np.linalg.norm(track.poses.translation - followed.truth[is_stated], axis=1)
    assert np.median(error) < 0.1
    up = track.poses.rotation.apply([0.0, 0.0, 1.0])
    assert np.median(up[:, 2]) > 0.99


def test_the_field_turns_with_the_map(place, followed):
    T = RigidTransform.from_components([5.0, 1.0, 2.0], Rotation.from_rotvec([0, 0, 1.0]))
    track = mm.localize(place.field_map.transformed(T), followed.log)
    is_stated = track.is_stated
    assert is_stated.mean() > 0.8
    error = np.linalg.norm(track.poses.translation - T.apply(followed.truth[is_stated]), axis=1)
    assert np.median(error) < 0.1


def test_in_a_constant_field_nothing_is_stated_and_the_reason_is_named(followed):
    rng = np.random.default_rng(0)
    field_map = mm.build_map(mm.Survey(rng.uniform(0, 3, (60, 3)), np.tile([2e-5, 0.0, -4e-5], (60, 1))), SPLINE)
    result = mm.localize(field_map, followed.log).result()
    assert (result.status, result.share) == ("never", 0.0)
    assert "constant" in result.reason


def test_elsewhere_no_pose_is_stated(place):
    log, _ = drifting_walk(Place(101), 11, laps=1.5)
    track = mm.localize(place, log)
    assert not track.is_stated.any()
    assert track.result().status == "never"


def test_a_body_that_is_carried_off_is_lost_and_found_again(place, feed):
    one, _ = drifting_walk(Place(1), 21, laps=0.6, start=0.0)
    other, p_other = drifting_walk(Place(1), 22, laps=0.8, start=3.5)
    localizer = mm.Localizer(place)
    assert feed(localizer, one)[-1].is_stated
    T_end = RigidTransform.from_components(one.positions[-1], one.orientations[-1])
    T_begin = RigidTransform.from_components(other.positions[0], other.orientations[0])
    after = feed(localizer, other, T=T_end * T_begin.inv(), later=one.times[-1] + 1.0)
    is_wrong = [
        e.is_stated and np.linalg.norm(e.T_map_body.translation - p) > 0.6
        for e, p in zip(after, p_other, strict=True)
    ]
    walked = np.linspace(0, 1, len(after)) * 0.8 * 20.8
    assert walked[np.flatnonzero(is_wrong)].max(initial=0.0) < 2.5
    assert any(e.status == "lost" for e in after)
    assert after[-1].is_stated
    assert np.linalg.norm(after[-1].T_map_body.translation - p_other[-1]) < 0.3


def test_a_sensor_whose_bias_jumps_is_not_followed_astray(place):
    log, truth = drifting_walk(Place(1), 23, laps=1.6, start=2.0)
    half = len(log) // 2
    jump = np.where(np.arange(len(log))[:, None] > half, [15e-6, -10e-6, 8e-6], 0.0)
    jumped = replace(log, field=log.field + log.orientations.apply(jump))
    estimates = mm.localize(place, jumped, live=True).estimates
    off = [np.linalg.norm(e.T_map_body.translation - p) for e, p in zip(estimates, truth, strict=True) if e.is_stated]
    assert max(off) < 0.6
    assert estimates[-1].is_stated
    np.testing.assert_allclose(estimates[-1].bias, [15e-6, -10e-6, 8e-6], atol=1e-6)


def test_outside_the_map_a_pose_is_stated_only_while_it_is_known(place, feed):
    log, truth = drifting_walk(Place(1), 24, laps=0.8, start=0.5)
    localizer = mm.Localizer(place)
    assert feed(localizer, log)[-1].is_stated
    # Straight on, away from the loop, through a uniform field.
    step = truth[-1] - truth[-4]
    positions = log.positions[-1] + 0.1 * np.arange(1, 400)[:, None] * step / np.linalg.norm(step)
    found = feed(localizer, ahead_of(log, positions, np.tile([20e-6, 0.0, -45e-6], (399, 1))))
    assert not any(e.is_stated for e in found[200:])
    assert all(np.sqrt(np.diag(e.covariance)[3:].max()) < 0.3 for e in found if e.is_stated)


def ahead_of(log, positions, field):
    """The body goes on after a log, at 10 Hz, without turning; the field in the odometry's frame."""
    n = len(positions)
    R = Rotation.concatenate([log.orientations[-1]] * n)
    return mm.Survey(positions, field, log.times[-1] + 0.1 * np.arange(1, n + 1), R)


def test_a_body_whose_odometry_slips_out_of_the_map_is_found_in_it_again(place, feed):
    log, truth = drifting_walk(Place(1), 24, laps=2.0, start=0.5)
    slip = np.clip(np.arange(len(log)) - len(log) // 2, 0, 30) * 0.2
    log = replace(log, positions=log.positions + slip[:, None] * [0.0, -1.0, 0.0])
    whole, localizer = mm.localize(place, log), mm.Localizer(place)
    assert whole.is_stated.mean() > 0.8
    assert np.linalg.norm(whole.poses.translation - truth[whole.is_stated], axis=1).max() < 0.6
    # Who was trusted to be outside is said to be lost before another place is stated, for one sample.
    live = feed(localizer, log)
    n = [e.reason for e in live].index(FOUND_ELSEWHERE)
    assert live[n].status == "lost"
    assert all(
        np.linalg.norm(e.T_map_body.translation - p) < 0.3 for e, p in zip(live[-20:], truth[-20:], strict=True)
    )
    again, T = mm.Localizer(place), RigidTransform.from_components(log.positions[n], log.orientations[n])
    feed(again, log, slice(0, n + 1))
    # It stands: no bin is completed.
    again.update(log.times[n] + 0.1, T, log.orientations[n].inv().apply(log.field[n]))
    assert again.estimate().is_stated


def test_outside_the_map_odometry_is_taken_to_drift_no_less_than_stated(place, feed):
    """Of how it drifts there, a path inside by good odometry tells nothing."""
    log, _ = drifting_walk(Place(1), 27, laps=1.5, start=1.0, turn=0.1, scale=0.001)
    localizer, R = mm.Localizer(place), log.orientations[-1]
    assert feed(localizer, log)[-1].drift < 0.5
    positions = log.positions[-1] + R.apply(np.outer(np.arange(1, 120), [0.0, -0.1, 0.0]))
    found = feed(localizer, ahead_of(log, positions, np.tile(log.field[-1], (119, 1))))
    assert next(e for e in found if e.status == "dead_reckoning").drift >= 1


BAD = {
    "NaN in the field": (1e9, RigidTransform.identity(), [np.nan, 0, 0], ValueError, "finite"),
    "a field in uT": (1e9, RigidTransform.identity(), [20.0, 0, -45.0], ValueError, "1e-6"),
    "two numbers": (1e9, RigidTransform.identity(), [2e-5, 0], ValueError, "three"),
    "a clock that runs backward": (-1.0, RigidTransform.identity(), [2e-5, 0, 0], ValueError, "after"),
    "a time that is none": (np.nan, RigidTransform.identity(), [2e-5, 0, 0], ValueError, "finite"),
    "a matrix": (1e9, np.eye(4), [2e-5, 0, 0], TypeError, "RigidTransform"),
}


def test_a_bad_sample_is_refused_and_leaves_the_state_as_it_was(place, followed, feed):
    clean, troubled = mm.Localizer(place), mm.Localizer(place)
    feed(clean, followed.log, slice(0, 60))
    feed(troubled, followed.log, slice(0, 40))
    for t, T, field, kind, said in BAD.values():
        with pytest.raises(kind, match=said):
            troubled.update(t, T, field)
    feed(troubled, followed.log, slice(40, 60))
    a, b = clean.estimate(), troubled.estimate()
    assert (a.status, a.matrix.tolist()) == (b.status, b.matrix.tolist())


def test_odometry_that_begins_anew_is_no_step(place, followed, feed):
    localizer = mm.Localizer(place)
    assert feed(localizer, followed.log, slice(0, 100))[-1].is_stated
    T = RigidTransform.from_translation([100.0, 0.0, 0.0])
    log = followed.log
    R = log.orientations
    with pytest.raises(OdometryJump, match="a jump of"):
        localizer.update(
            log.times[100], T * RigidTransform.from_components(log.positions[100], R[100]),
            R[100].inv().apply(log.field[100]),
        )  # fmt: skip
    found = feed(localizer, log, slice(101, 140), T=T)
    assert all(e.is_stated for e in found)
    assert np.linalg.norm(found[-1].T_map_body.translation - followed.truth[139]) < 0.3


def test_a_body_that_stands_still_learns_nothing(place, followed, feed):
    localizer, log = mm.Localizer(place), followed.log.subset(np.arange(100))
    before = feed(localizer, log)[-1]
    after = feed(localizer, ahead_of(log, np.tile(log.positions[-1], (300, 1)), np.tile(log.field[-1], (300, 1))))[-1]
    np.testing.assert_array_equal(after.matrix, before.matrix)
    assert after.probability == before.probability


def test_other_things_than_maps_and_logs_are_named(place):
    with pytest.raises(TypeError, match="build_map"):
        mm.Localizer("hall.map")
    with pytest.raises(TypeError, match="config"):
        mm.Localizer(place, mm.SlamConfig())
    log, _ = drifting_walk(Place(1), 3, laps=0.5)
    with pytest.raises(mm.SurveyError, match="times"):
        mm.localize(place, mm.Survey(log.positions, log.field))


# A fine demand, stated at once.
FINE = mm.LocalizerConfig(
    stands=0.0, decision={"prior_odds": 1 / 16, "max_sd_translation": None, "max_sd_rotation": 0.16}
)


def test_a_body_that_was_out_of_the_map_is_found_again_soon_after_it_is_back(place, feed):
    log, truth = drifting_walk(Place(1), 26, laps=0.8, start=0.5)
    localizer, R, end = mm.Localizer(place, FINE), log.orientations[-1], 0.5 + 1.6 * np.pi
    assert feed(localizer, log)[-1].is_stated
    # 12 m straight out of the map and back, by odometry that turns, and a walk on.
    ahead = 0.1 * np.r_[1:121, 120:0:-1][:, None] * [[1.0, 0.0, 0.0]]
    heading = about_z(loop(np.array([end]))[1])
    field = R.apply(heading.inv().apply(Place(1).field(truth[-1] + heading.apply(ahead))))
    positions = log.positions[-1] + R.apply(ahead + 0.01 * np.arange(240)[:, None] * [0.0, 0.2, 0.0])
    feed(localizer, ahead_of(log, positions, field))
    then, truth = drifting_walk(Place(1), 36, laps=0.8, start=end)
    last = RigidTransform.from_components(positions[-1], R)
    T = last * RigidTransform.from_components(then.positions[0], then.orientations[0]).inv()
    said = feed(localizer, then, T=T, later=log.times[-1] + 24.1)
    is_stated = np.array([e.is_stated for e in said])
    off = [np.linalg.norm(e.T_map_body.translation - p) for e, p in zip(said, truth, strict=True) if e.is_stated]
    assert max(off) < 0.6
    # Five of the map's field lengths.
    assert np.argmax(is_stated) / len(said) * 0.8 * 20.8 < 3.0
    assert is_stated[len(said) // 2 :].all()
