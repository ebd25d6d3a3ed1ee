# SPDX-License-Identifier: BSD-3-Clause
"""Errors of raw logs, applied to a clean survey: hard and soft iron, a clock offset, spikes, currents."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.typing import Matrix, Scalars, Vector3


@dataclass(frozen=True, eq=False, slots=True)
class Corruption:
    """Errors of a sensor and its log.

    Attributes
    ----------
    hard_iron : (3,) array, T
        Added to every reading, sensor frame.
    soft_iron : (3, 3) array
        Multiplies the true field, sensor frame; the identity for a perfect sensor.
    clock_offset : float, s
        To be added to the magnetometer's times to have those of the poses.
    n_spikes : int
        Number of readings with an error of `spike_size` in a random direction.
    spike_size : float, T
        Size of a spike.
    current : (n,) array, A, optional
        A current aboard, one value per sample.
    current_coefficient : (3,) array, T/A
        What it adds to the readings, sensor frame.
    """

    hard_iron: Vector3 = field(default_factory=lambda: np.zeros(3))
    soft_iron: Matrix = field(default_factory=lambda: np.eye(3))
    clock_offset: float = 0.0
    n_spikes: int = 0
    spike_size: float = 30e-6
    current: Scalars | None = None
    current_coefficient: Vector3 = field(default_factory=lambda: np.zeros(3))


def draw_corruption(
    rng: np.random.Generator, hard_iron: float = 30e-6, soft_iron: float = 0.05, clock_offset: float = 0.04
) -> Corruption:
    """Errors of stated size in random directions."""
    direction = rng.standard_normal(3)
    stretch = rng.uniform(-1, 1, 3)
    stretch -= stretch.mean()
    axes = Rotation.random(rng=rng).as_matrix()
    return Corruption(
        hard_iron=hard_iron * direction / np.linalg.norm(direction),
        soft_iron=np.eye(3) + soft_iron * (axes * (stretch / np.abs(stretch).max())) @ axes.T,
        clock_offset=float(clock_offset * rng.choice([-1, 1])),
    )


def corrupt(survey: Survey, corruption: Corruption, rng: np.random.Generator) -> tuple[Survey, np.ndarray]:
    """A survey with the errors of a raw log, and which of its samples remain.

    Readings are taken at the clean survey's poses, but have the stamps of another clock and are rotated with the
    poses at those stamps; stamps outside the trajectory are dropped.
    """
    if survey.orientations is None or survey.times is None:
        msg = "only a survey with orientations and times can be corrupted: hard iron turns with the sensor"
        raise ValueError(msg)
    readings = survey.orientations.apply(survey.field, inverse=True) @ corruption.soft_iron.T + corruption.hard_iron
    if corruption.current is not None:
        readings += corruption.current[:, None] * corruption.current_coefficient
    hit = rng.choice(len(survey), corruption.n_spikes, replace=False)
    directions = rng.standard_normal((corruption.n_spikes, 3))
    readings[hit] += corruption.spike_size * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    trajectory = Trajectory(survey.times, survey.positions, survey.orientations)
    stamps = survey.times - corruption.clock_offset
    rows = np.flatnonzero(trajectory.covers(stamps))
    positions, orientations = trajectory.interpolate(stamps[rows])
    corrupted = replace(
        survey,
        positions=positions,
        field=orientations.apply(readings[rows]),
        times=stamps[rows],
        orientations=orientations,
    )
    return corrupted, rows
