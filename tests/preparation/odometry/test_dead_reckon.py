# SPDX-License-Identifier: BSD-3-Clause
"""Dead reckoning of made-up walks with known paths, and of real ones where they are present."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magmatch.data
from magmatch.data.formats.phones.phone_log import PhoneLog, Stream
from magmatch.data.formats.phones.read import read_phone_log
from magmatch.errors import DataFormatError, MissingExtraError
from magmatch.preparation.odometry.dead_reckon import STEP_FREQUENCY, WEINBERG_FACTOR, dead_reckon

pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
MALL = Path(magmatch.data.__file__).parent / "samples/mall/walks"
RATE, STEP_RATE, SWING, G = 100.0, 1.8, 2.5, 9.81
SQUARE = [(10.0, 0.0), *((12.0 * k + r, 90.0 * k) for k in (1, 2, 3) for r in (0.0, 10.0))]


def walk(turns=SQUARE, *, pitch_deg=50.0, stand=5.0, bias=(0.0, 0.0, 0.0), rate=RATE, still=0.0):
    """Sensors of a phone that points along the path, after standing for a while.

    `turns` are (s, heading in deg), between which it turns evenly.
    """
    knots = [(0.0, 0.0), (stand, 0.0), *((stand + t, h) for t, h in turns)]
    times = np.arange(0, knots[-1][0] + still, 1 / rate)
    heading = np.radians(np.interp(times, *np.array(knots).T))
    held = Rotation.from_euler("x", pitch_deg, degrees=True)
    # The phone's top, its y axis, points along the path.
    orientations = Rotation.from_euler("z", (heading - np.pi / 2)[:, None]) * held
    walking = (times > stand) & (times < knots[-1][0])
    up = G + SWING * walking * np.sin(2 * np.pi * STEP_RATE * (times - stand))
    felt = orientations.apply(np.outer(up, [0, 0, 1]), inverse=True)
    spin = (orientations[:-1].inv() * orientations[1:]).as_rotvec() * rate
    gyro = np.vstack([spin, spin[-1:]]) + bias
    streams = {"acceleration": Stream(times[::2], felt[::2], "acceleration"), "rate": Stream(times, gyro, "rate")}
    return PhoneLog(Path("walk.zip"), "made up", streams)


def length_of(seconds):
    """What Weinberg's rule makes of the steps in some time; the low-pass takes a part of the swing."""
    kept = 1 / (1 + (np.tan(np.pi * STEP_RATE / RATE) / np.tan(np.pi * STEP_FREQUENCY / RATE)) ** 4)
    return seconds * STEP_RATE * WEINBERG_FACTOR * (2 * SWING * kept) ** 0.25


def test_a_square_walk_is_a_square_of_the_right_size():
    found = dead_reckon(walk())
    p, t = found.trajectory.positions, found.trajectory.times
    assert not p[0].any()
    assert not p[:, 2].any()
    assert len(found.steps) == pytest.approx(46 * STEP_RATE, abs=2)
    assert found.length == pytest.approx(length_of(46), rel=0.05)
    np.testing.assert_allclose(p[-1], 0, atol=2.0)
    corners = [p[np.searchsorted(t, 5 + s)] for s in (11, 23, 35)]
    sides = np.diff([p[0], *corners], axis=0)
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1), length_of(12), rtol=0.15)
    assert abs(sides[0] @ sides[1]) < 0.1 * np.linalg.norm(sides[0]) * np.linalg.norm(sides[1])


@pytest.mark.parametrize("pitch_deg", [-20.0, 0.0, 30.0, 75.0])
def test_the_path_does_not_depend_on_how_the_phone_is_tilted(pitch_deg):
    paths = [dead_reckon(walk(pitch_deg=pitch)).trajectory.positions for pitch in (pitch_deg, 50.0)]
    apart = [np.linalg.norm(p[-1] - p[len(p) // 2]) for p in paths]
    np.testing.assert_allclose(*apart, rtol=0.02)
    lengths = [np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in paths]
    np.testing.assert_allclose(*lengths, rtol=0.01)


def test_a_gyroscope_in_degrees_is_refused():
    log = read_phone_log(MALL / "walk1.txt.gz", ("acceleration", "rate"))
    rate = log.streams["rate"]
    in_degrees = replace(log, streams={**log.streams, "rate": replace(rate, values=np.degrees(rate.values))})
    with pytest.raises(DataFormatError, match=r"turns \d\d times as far as gravity .* expected rad/s"):
        dead_reckon(in_degrees)
    assert len(dead_reckon(log).steps)


def test_the_bias_of_the_gyroscope_is_learned_at_rest():
    bias = np.radians([0.6, -0.8, 0.7])
    straight = [(60.0, 0.0)]
    path = dead_reckon(walk(straight, bias=bias, stand=10.0)).trajectory.positions
    middle = path[len(path) // 2]
    sideways = np.cross(path[-1], middle)[2] / np.linalg.norm(path[-1])
    free = 60 * np.linalg.norm(path[-1]) / 4 * np.linalg.norm(bias)
    assert abs(sideways) < 0.1 * free


def without(sensor):
    log = walk()
    return PhoneLog(log.path, log.app, {k: v for k, v in log.streams.items() if k != sensor})


def years():
    log = walk()
    return PhoneLog(log.path, log.app, {k: Stream(s.times * 1e5, s.values, s.source) for k, s in log.streams.items()})


def changed(sensor, times=lambda t: t, values=lambda v: v):
    log = walk()
    s = log.streams[sensor]
    stream = Stream(times(s.times), values(s.values), s.source)
    return PhoneLog(log.path, log.app, dict(log.streams) | {sensor: stream})


def standing():
    log = walk(stand=10.0)
    still = {k: Stream(s.times[: len(s) // 10], s.values[: len(s) // 10], s.source) for k, s in log.streams.items()}
    return PhoneLog(log.path, log.app, still)


BAD = {
    "no gyroscope": (lambda: without("rate"), "expected readings of the gyroscope for dead reckoning"),
    "no accelerometer": (lambda: without("acceleration"), "expected readings of the accelerometer with gravity"),
    "no gravity": (lambda: changed("acceleration", values=lambda v: v - v[0]), "expected accelerations with gravity"),
    "two clocks": (lambda: changed("rate", times=lambda t: t + 1e6), "the sensors share"),
    "a slow sensor": (lambda: changed("rate", times=lambda t: t * 20), "readings a second, expected at least"),
    "a day and more": (years, "expected a walk of"),
    "no walk": (standing, "no step is found"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_reckoned_is_said(case):
    make, words = BAD[case]
    with pytest.raises(DataFormatError, match=words):
        dead_reckon(make())


def test_poses_reach_the_last_reading_of_both_sensors():
    log = walk(rate=97.0)
    found = dead_reckon(log).trajectory
    stop = min(stream.times[-1] for stream in log.streams.values())
    assert found.times[-1] == stop
    before = dead_reckon(
        PhoneLog(
            log.path, log.app, {k: Stream(s.times[:-3], s.values[:-3], s.source) for k, s in log.streams.items()}
        )
    ).trajectory
    (last,) = np.diff(found.positions[-2:], axis=0)
    assert np.linalg.norm(last) <= 2.0 * (stop - found.times[-2])  # no faster than people walk
    assert before.times[-1] < stop


def cut(log, at, seconds, turning=0.0):
    """The log with a pause, before which the phone turns (rad/s about its z) for a moment."""
    streams = {}
    for sensor, s in log.streams.items():
        values = s.values + (turning * (np.abs(s.times - at) < 0.02)[:, None] * [0, 0, 1] if sensor == "rate" else 0)
        streams[sensor] = Stream(s.times + seconds * (s.times >= at), values, s.source)
    return PhoneLog(log.path, log.app, streams)


def test_nothing_is_walked_or_turned_in_a_pause(caplog):
    """Not even where the phone turned when it was paused."""
    whole, paused = dead_reckon(walk()).trajectory, dead_reckon(cut(walk(), 20.0, 60.0, turning=0.5)).trajectory
    is_in_it = (paused.times > 20.0) & (paused.times < 80.0)
    assert not is_in_it.any()
    assert paused.times[-1] == pytest.approx(whole.times[-1] + 60, abs=0.02)
    row = int(np.searchsorted(paused.times, 50.0))
    (step,) = np.diff(paused.positions[[row - 1, row]], axis=0)
    assert np.linalg.norm(step) < 0.05
    shift = np.interp(whole.times[-1], whole.times, whole.positions[:, 0]) - paused.positions[-1, 0]
    assert abs(shift) < 1.0  # the step that was cut in two
    assert "the path is in 2 pieces" in caplog.text


def test_without_vqf_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "vqf", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[odometry\]'"):
        dead_reckon(walk())


def test_orientations_take_the_phones_axes_to_a_frame_whose_z_is_up_and_gaps_are_said(caplog):
    log = walk(pitch_deg=35.0)
    found = dead_reckon(log).trajectory
    resting = found.times < 4
    up = found.orientations[resting].inv().apply([0, 0, 1])
    truth = log.streams["acceleration"].values[0] / G
    np.testing.assert_allclose(up, np.broadcast_to(truth, up.shape), atol=0.02)
    assert "gap" not in caplog.text
    dead_reckon(changed("rate", times=lambda t: t + 0.5 * (t > 20)))
    assert "has 1 gap, the longest 0.51 s" in caplog.text
