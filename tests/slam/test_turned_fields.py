# SPDX-License-Identifier: BSD-3-Clause
"""Logs whose field is turned against that of the others: a phone that was held another way."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from drifting import Place, about_z, drifting_walk, loop
from magmatch.data.survey import Survey
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.run import slam
from magmatch.slam.turned_fields import turned_logs


def walk(seed, bias=(0.0, 0.0, 0.0), laps=1.2, place=1):
    """A walk where it truly was, by a sensor that faces forward."""
    log, truth = drifting_walk(Place(place), seed, laps=laps, turn=0.0, scale=0.0, name=f"{seed}.csv")
    R = about_z(loop(np.linspace(0, 2 * np.pi * laps, len(truth)))[1])
    first = R[0]
    return Survey(truth, first.apply(log.field) + R.apply(bias), times=log.times, orientations=R, name=log.name)


def held_sideways(log, degrees=90.0):
    turn = about_z(np.radians(degrees))
    return replace(log, field=turn.apply(log.field), orientations=turn * log.orientations)


@pytest.mark.parametrize("degrees", [40.0, 90.0, -150.0])
def test_the_one_log_that_is_turned_is_named_with_its_turn(degrees):
    logs = [walk(1), held_sideways(walk(2), degrees), walk(3)]
    ((one, angle, others),) = turned_logs(logs, 1.0)
    assert (one, others) == (1, [0, 2])
    assert angle == pytest.approx(degrees, abs=3)


def test_of_two_that_contradict_each_other_the_later_one_is_named():
    ((one, angle, others),) = turned_logs([held_sideways(walk(1)), walk(2)], 1.0)
    assert (one, others) == (1, [0])
    assert angle == pytest.approx(-90, abs=3)


def test_biases_are_no_turn_and_do_not_hide_one():
    biases = [(8e-6, 0, 0), (-5e-6, 7e-6, 0), (0, 0, 0)]
    logs = [walk(k, bias) for k, bias in enumerate(biases)]
    assert turned_logs(logs, 1.0) == []
    assert [one for one, *_ in turned_logs([held_sideways(logs[0]), *logs[1:]], 1.0)] == [0]


def test_logs_that_hardly_meet_tell_no_turn():
    short = held_sideways(walk(2, laps=0.3))
    assert turned_logs([walk(1), short], 1.0) == []
    assert turned_logs([walk(1), replace(held_sideways(walk(2)), positions=walk(2).positions + 50.0)], 1.0) == []


def vertical(log):
    return replace(log, field=log.field * [0, 0, 1])


@pytest.mark.parametrize(
    "logs",
    [
        lambda: [walk(1), held_sideways(walk(2), 15.0)],  # as small as misalignment
        lambda: [walk(1), walk(2, place=7)],  # fields that merely differ
        lambda: [vertical(walk(1)), vertical(walk(2))],
    ],
)
def test_what_is_no_turn_is_not_told(logs):
    assert turned_logs(logs(), 1.0) == []


def test_slam_names_a_log_that_fixed_points_tie_to_the_others(caplog):
    """The map would be a mean of fields that contradict each other, and its status connected."""
    walks = [drifting_walk(Place(1), k, laps=1.2, name=f"{k}.csv", turn=0.5) for k in (1, 2, 3)]
    rows = range(0, 240, 40)
    points = [Anchor(log.name, log.times[k], truth[k], 0.05) for log, truth in walks for k in rows]
    logs = [log for log, _ in walks]
    with caplog.at_level(logging.WARNING):
        slam(logs, anchors=points)
    assert "its field is turned" not in caplog.text
    with caplog.at_level(logging.WARNING):
        slam([*logs[:2], held_sideways(logs[2])], anchors=points)
    (said,) = [r.getMessage() for r in caplog.records if "its field is turned" in r.getMessage()]
    assert said.startswith("3.csv: its field is turned by 9")
    assert "against that of 1.csv, 2.csv" in said
    assert "upper end forward" in said
