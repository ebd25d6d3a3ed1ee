# SPDX-License-Identifier: BSD-3-Clause
"""The drift of a log's odometry according to the covariance of its poses, if that is plausible."""

import logging
from array import array
from contextlib import suppress
from pathlib import Path

import numpy as np

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.sniff import sniff
from magmatch.data.logs.messages import MalformedError, decode
from magmatch.data.logs.open import opened_log
from magmatch.data.logs.read import list_topics
from magmatch.data.units import DAMAGED, STATED_OVER
from magmatch.geometry import path_walked
from magmatch.typing import Points, Tensors

logger = logging.getLogger(__name__)

ODOMETRY = "nav_msgs/Odometry"
# Poses looked at.
MOST_POSES = 2000


def read_drift(path: str | Path, layout: SurveyFormat | None = None) -> tuple[float, float] | None:
    """Drift over a walk of 10 m as the odometry of a log states it: m per axis, and degrees about the vertical.

    None where the log has no such odometry, or its covariance cannot be that of a path: not positive definite,
    wider than the path is long, or one that does not grow. JSON messages are not looked at.
    """
    layout = layout or SurveyFormat()
    if sniff(path) != "log" or layout.trajectory is not None:
        return None
    topics, chosen = list_topics(path, layout)
    topic = next((t for t in topics if t.name == chosen["poses"]), None)
    if topic is None or topic.type != ODOMETRY or topic.encoding == "json":
        return None
    stamps, numbers = array("q"), array("d")
    with opened_log(path) as log:
        for channel, log_ns, payload in log.messages({topic.name}):
            with suppress(MalformedError):
                pose = decode(channel, payload).pose
                stamps.append(log_ns)
                numbers.extend([pose.pose.position.x, pose.pose.position.y, pose.pose.position.z, *pose.covariance])
    rows = np.array(numbers).reshape(-1, 39)[np.argsort(stamps, kind="stable")]
    found = drift(rows[:, :3], rows[:, 3:].reshape(-1, 6, 6))
    if found is not None:
        logger.info("%s: its odometry states a drift of %.2g m and %.2g degrees in 10 m", path, *found)
    return found


def drift(positions: Points, covariances: Tensors) -> tuple[float, float] | None:
    """Random steps of place and heading, m and degrees in 10 m, from which the covariances of poses follow.

    Covariances (n, 6, 6) have the place first, as in ROS. A step of length s adds ``q s`` to the heading's variance
    and ``p s`` to that of the place along each axis, beside what the heading's error so far carries along.
    """
    rows = np.unique(np.linspace(0, len(positions) - 1, min(len(positions), MOST_POSES)).astype(np.int64))
    x, C = positions[rows, :2], covariances[rows][:, [0, 1, 5]][:, :, [0, 1, 5]]
    if len(rows) < 3 or not ((np.abs(x) < DAMAGED).all() and np.isfinite(C).all()):
        return None
    s = path_walked(x)
    place, turn = C[:, 0, 0] + C[:, 1, 1], C[:, 2, 2]
    moved = s > s[-1] / 2
    is_one = s[-1] > 0 and np.linalg.eigvalsh(C[moved])[:, 0].min() > 0 and place.max() < s[-1] ** 2
    if not is_one or turn.max() > np.pi**2:
        return None
    third = np.minimum((3 * s / s[-1]).astype(np.int64), 2)
    means = [turn[third == k].mean() for k in range(3) if (third == k).any()]
    if len(means) < 3 or not (np.diff(means) > 0).all():  # it grows from each third of the path to the next
        return None
    # What each step adds to what the turns before it carry along.
    F = np.tile(np.eye(3), (len(x) - 1, 1, 1))
    F[:, 0, 2], F[:, 1, 2] = -np.diff(x[:, 1]), np.diff(x[:, 0])
    added = (C[1:] - F @ C[:-1] @ np.swapaxes(F, 1, 2)).sum(axis=0)
    p, q = (added[0, 0] + added[1, 1]) / (2 * s[-1]), added[2, 2] / s[-1]
    if p <= 0 or q <= 0:
        return None
    return float(np.sqrt(p * STATED_OVER)), float(np.degrees(np.sqrt(q * STATED_OVER)))
