# SPDX-License-Identifier: BSD-3-Clause
"""Walks through a place whose field is known, with poses that drift as dead reckoning does."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field import build
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.runner import Runner
from magmatch.slam.loop_search import LoopSearch
from magmatch.slam.session import Session

EARTH = np.array([20e-6, 0.0, -45e-6])
# Half sides of the loop that is walked, m.
HALF = np.array([4.0, 2.5])
# With which a map of a walk there is made at once.
GIVEN = FieldConfig(prior="spline", lengthscale=1.0, signal_sd=8e-6, noise_sd=5e-7, spacing=0.5)
NUMBERS = Hyperparameters(1.0, 8e-6, 5e-7, 0.5, 300.0)


def give_numbers(patch):
    """Maps of sessions have the given numbers, and no others are chosen beside them."""
    choose = build.choose_numbers

    def given(prior, samples, config):
        return NUMBERS if config is GIVEN else choose(prior, samples, config)

    patch.setattr(build, "choose_numbers", given)
    patch.setitem(Session.map.__globals__, "SPLINE", GIVEN)


class Place:
    """Dipoles below and above the floor of a loop, drawn from a seed."""

    def __init__(self, seed, n=60):
        rng = np.random.default_rng(seed)
        self.centers = rng.uniform(-1, 1, (n, 3)) * [*(HALF + 1), 0] + [0, 0, 1] * rng.choice([-1.0, 1.2], (n, 1))
        self.moments = rng.normal(0, 1.5, (n, 3))  # uT m^3

    def field(self, x):
        return dipoles(x, self.centers, 1e-6 * self.moments) + EARTH


def loop(s):
    """Places on an ellipse after so much of its angle, and the heading there."""
    p = np.column_stack([HALF[0] * np.cos(s), HALF[1] * np.sin(s), 0 * s])
    return p, np.arctan2(HALF[1] * np.cos(s), -HALF[0] * np.sin(s))


def about_z(angles):
    return Rotation.from_rotvec(np.atleast_1d(angles)[:, None] * [0.0, 0.0, 1.0])


def drifting_walk(place, seed, laps=2.0, start=0.0, name="walk.csv", bias=(0.0, 0.0, 0.0), turn=1.5, scale=0.01):
    """A log of some laps with its odometry's frame at its start, and the true positions."""
    rng = np.random.default_rng(seed)
    n = int(210 * laps)
    s = start + np.linspace(0, 2 * np.pi * laps, n)
    p, heading = loop(s)
    # Nobody walks the same line twice.
    beside = np.convolve(rng.standard_normal(n + 60), np.ones(60) / np.sqrt(60), "valid")[:n]
    p = p + 0.08 * beside[:, None] * np.column_stack([-np.sin(heading), np.cos(heading), 0 * heading])
    b = place.field(p) + 2e-7 * rng.standard_normal((n, 3))
    R = about_z(heading)
    steps = np.diff(p, axis=0)
    length = np.linalg.norm(steps, axis=1)
    drift = np.cumsum(np.radians(turn) * np.sqrt(length) * rng.standard_normal(n - 1))
    walked = np.concatenate([p[:1], p[0] + np.cumsum(about_z(drift).apply(steps) * (1 + scale), axis=0)])
    wrong = about_z(np.concatenate([[0.0], drift]))
    log = Survey(
        walked, wrong.apply(b) + (wrong * R).apply(bias), times=0.1 * np.arange(n), orientations=wrong * R, name=name
    )
    T = RigidTransform.from_components(p[0], R[0]).inv()
    return log.transformed(T), p


def trajectory_error(p_true, p):
    """Root mean square of positions after one rigid alignment, m."""
    a, b = p - p.mean(axis=0), p_true - p_true.mean(axis=0)
    R, _ = Rotation.align_vectors(b, a)
    return float(np.sqrt(((R.apply(a) - b) ** 2).sum(axis=1).mean()))


def submap_at(places, node):
    """The submap that is made for a node's window, odometry's frame."""
    return made(LoopSearch(places, Runner()).submap(node))


def made(shared):
    """What tasks share, as it is made."""
    return shared.make(*shared.arguments)
