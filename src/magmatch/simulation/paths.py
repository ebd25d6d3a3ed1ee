# SPDX-License-Identifier: BSD-3-Clause
"""A sensor is carried along a path: hand-held sweeps, robot circles, a corridor loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from magmatch.geometry import path_walked
from magmatch.typing import Points, Scalars, Vector3


@dataclass(frozen=True, eq=False, slots=True)
class SensorPath:
    """True sensor poses, world frame."""

    positions: Points  # (n, 3), m: world frame
    times: Scalars | None = None  # (n,), s: strictly increasing; None for samples in no order
    # Length n, optional: takes sensor coordinates to world coordinates; None for a sensor that did not turn
    orientations: Rotation | None = None


def resample(corners: Points, n: int) -> Points:
    """Points at equal distances along a chain of straight lines, both ends included."""
    walked = path_walked(corners)
    at = np.linspace(0, walked[-1], n)
    return np.column_stack([np.interp(at, walked, corners[:, axis]) for axis in range(3)])


def boustrophedon(
    low: Vector3, high: Vector3, heights: Sequence[float], row_spacing: float, along: int, n: int
) -> Points:
    """Sweep a rectangle row by row, back and forth, one height after another."""
    across = 1 - along
    n_rows = int(np.ceil((high[across] - low[across]) / row_spacing)) + 1
    rows = np.linspace(low[across], high[across], n_rows)
    corners = []
    ends = (float(low[along]), float(high[along]))
    for k, height in enumerate(heights):
        for row in rows if k % 2 == 0 else rows[::-1]:
            for end in ends:
                corner = np.empty(3)
                corner[along], corner[across], corner[2] = end, row, height
                corners.append(corner)
            ends = ends[::-1]
    return resample(np.array(corners), n)


def circles(center: Vector3, radii: Sequence[float], laps: int, n: int) -> Points:
    """Circles about a point, one radius after another, at constant height."""
    angle = np.linspace(0, 2 * np.pi * laps, 180 * laps + 1)
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle]) for r in radii]
    return resample(np.concatenate(rings) + center, n)


def wander(size: tuple[float, float, float], n: int, interval: float, rng: np.random.Generator) -> Points:
    """Walk to and fro through a box, as somebody does who waves a sensor about to fill it.

    Each coordinate swings with a period of its own, so that the path crosses itself under many headings.
    """
    period = np.array([13.0, 17.3, 7.1]) * rng.uniform(0.9, 1.1, 3)
    angle = 2 * np.pi * np.arange(n)[:, None] * interval / period + rng.uniform(0, 2 * np.pi, 3)
    return np.asarray(np.array(size) / 2 * np.sin(angle))


def around_loop(size: tuple[float, float], corner_radius: float, s: Scalars) -> tuple[Points, Scalars]:
    """Points (m, z = 0) and headings (rad) on a rounded rectangle, anticlockwise from its first long side."""
    arc = corner_radius * np.pi / 2
    positions, heading = np.zeros((len(s), 3)), np.zeros(len(s))
    left = np.mod(s, loop_length(size, corner_radius))
    corner, yaw = np.array([corner_radius, 0.0]), 0.0
    for k, side in enumerate((size[0], size[1], size[0], size[1])):
        straight = side - 2 * corner_radius
        end = straight + arc if k < 3 else np.inf  # rounding must not leave a point beyond the last corner
        forward, inward = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        on_straight = (left >= 0) & (left < straight)
        positions[on_straight, :2] = corner + left[on_straight, None] * forward
        heading[on_straight] = yaw
        on_arc = (left >= straight) & (left < end)
        turned = (left[on_arc] - straight) / corner_radius
        bend = np.sin(turned)[:, None] * forward + (1 - np.cos(turned))[:, None] * inward
        positions[on_arc, :2] = corner + straight * forward + corner_radius * bend
        heading[on_arc] = yaw + turned
        corner = corner + straight * forward + corner_radius * (forward + inward)
        left, yaw = left - straight - arc, yaw + np.pi / 2
    return positions, heading


def loop_length(size: tuple[float, float], corner_radius: float) -> float:
    """Length of the loop of `around_loop`, m."""
    return 2 * (size[0] + size[1]) - (8 - 2 * np.pi) * corner_radius


def heading_along(positions: Points) -> Scalars:
    """Angle from x of the direction of travel at each point of a path: (n,), rad."""
    step = np.gradient(positions[:, :2], axis=0)
    return np.asarray(np.arctan2(step[:, 1], step[:, 0]))


def upright(heading: Scalars) -> Rotation:
    """Orientations of a sensor that looks where it goes, its heading from x (rad), z up."""
    return Rotation.from_euler("z", heading[:, None])


def smooth_noise(n: int, width: int, sd: float, rng: np.random.Generator) -> Scalars:
    """Wander of an unsteady hand: Gaussian noise without steps."""
    smooth = gaussian_filter1d(rng.standard_normal(n), width, mode="wrap")
    return np.asarray(sd * smooth / max(float(np.std(smooth)), np.finfo(float).tiny))
