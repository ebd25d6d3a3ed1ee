# SPDX-License-Identifier: BSD-3-Clause
"""Points that a phone's log marks itself, as fixed points."""

import logging
from collections.abc import Iterable

import numpy as np

from magmatch.data.formats.phones.phone_log import SurveyedPoints
from magmatch.data.survey import Survey
from magmatch.slam.graph.anchors import BEYOND, Anchor

logger = logging.getLogger(__name__)

# Per axis, m: people who walk at 1 m/s press the button within some tenths of a second of the point.
WAYPOINT_SD = 0.3


def waypoints(points: SurveyedPoints, survey: Survey, log: str) -> list[Anchor]:
    """Points of one log as its fixed points; those that it has no samples near are left out, which is logged.

    A plan says nothing of heights: each point lies as high as odometry has the log there.
    """
    times = survey.times
    assert times is not None  # what phones log has times
    is_passed = (points.times >= times[0] - BEYOND) & (points.times <= times[-1] + BEYOND)
    if not is_passed.all():
        words = "%s: %d of its %d surveyed points lie more than %g s before or after its samples (left out)"
        logger.warning(words, survey.name, (~is_passed).sum(), len(is_passed), BEYOND)
    heights = np.interp(points.times, times, survey.positions[:, 2])
    rows = zip(points.times, points.places, heights, points.lines, is_passed, strict=True)
    return [
        Anchor(log, float(t), np.array([x, y, z]), WAYPOINT_SD, f"{survey.name}, line {line}", points.in_degrees)
        for t, (x, y), z, line, counts in rows
        if counts
    ]


def warn_of_floors(logs: Iterable[SurveyedPoints | None]) -> None:
    """Say that logs were walked on several floors, whose heights dead reckoning does not know."""
    floors = sorted({floor for points in logs if points is not None for floor in points.floors})
    if len(floors) > 1:
        words = "surveyed points lie on floors %s, and are taken as of one: give the logs of one floor alone"
        logger.warning(words, ", ".join(floors))
