# SPDX-License-Identifier: BSD-3-Clause
"""A log before any correction: the magnetometer's readings, and poses on their own clock."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class SensorLog:
    """Readings in the sensor's frame and the poses they were taken at."""

    readings: Vectors  # (n, 3), T: sensor frame
    positions: Points  # (n, 3), m: poses as stamped, survey frame
    orientations: Rotation  # length n: takes sensor coordinates to survey coordinates
    times: Scalars | None = None  # (n,), s: stamps of the readings, strictly increasing
    trajectory: Trajectory | None = None  # poses at other times; there if and only if times are

    def __len__(self) -> int:
        return len(self.readings)

    @classmethod
    def of(cls, survey: Survey, trajectory: Trajectory | None = None) -> "SensorLog":
        """A survey's field turned back into the sensor's frame; poses of the trajectory, else of the samples."""
        assert survey.orientations is not None  # without them it is not known what the sensor read
        readings = survey.orientations.apply(survey.field, inverse=True)
        if survey.times is None:
            trajectory = None
        elif trajectory is None and len(survey) > 1:
            trajectory = Trajectory(survey.times, survey.positions, survey.orientations)
        times = None if trajectory is None else survey.times
        return cls(readings, survey.positions, survey.orientations, times, trajectory)

    def subset(self, rows: Mask | Indices) -> "SensorLog":
        """Readings chosen by a mask or by indices; the trajectory stays whole."""
        return replace(
            self,
            readings=self.readings[rows],
            positions=self.positions[rows],
            orientations=self.orientations[rows],
            times=None if self.times is None else self.times[rows],
        )

    def covered(self, offset: float, margin: float = 0.0) -> Mask:
        """Tell which readings have a pose once their stamps are moved by an offset (give or take a margin), s."""
        if self.times is None or self.trajectory is None:
            return np.ones(len(self), dtype=bool)
        is_covered: Mask = self.trajectory.covers(self.times + offset - margin)
        is_covered &= self.trajectory.covers(self.times + offset + margin)
        return is_covered

    def at(self, offset: float) -> tuple[Points, Rotation]:
        """Positions and orientations with the stamps moved by an offset, s; to the bit as recorded at 0."""
        if offset == 0 or self.times is None or self.trajectory is None:
            return self.positions, self.orientations
        return self.trajectory.interpolate(self.times + offset)

    def motion(self, offset: float) -> tuple[Vectors, Vectors]:
        """Velocity (n, 3), m/s, and spin (n, 3), rad/s, ``dR/dt = [spin]x R``, with stamps moved; survey frame."""
        if self.times is None or self.trajectory is None:
            return np.zeros_like(self.positions), np.zeros_like(self.positions)
        # Across one interval of the trajectory: shorter differences see only its interpolation.
        half = float(np.median(np.diff(self.trajectory.times))) / 2
        first, last = self.trajectory.times[[0, -1]]
        before, after = (np.clip(self.times + offset + step, first, last) for step in (-half, half))
        (p0, R0), (p1, R1) = self.trajectory.interpolate(before), self.trajectory.interpolate(after)
        span = np.maximum(after - before, 1e-9)[:, None]
        return (p1 - p0) / span, (R1 * R0.inv()).as_rotvec() / span
