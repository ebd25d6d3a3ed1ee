# SPDX-License-Identifier: BSD-3-Clause
"""`Trajectory`: poses over time, from another system than the magnetometer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from magmatch.arguments import column_of, expect_path, expect_rotations, points_of, require_increasing
from magmatch.brief import brief
from magmatch.data.tables.ordered_table import read_ordered
from magmatch.data.tables.table import Table
from magmatch.data.tables.tum import TUM_COLUMNS, write_tum
from magmatch.errors import DataFormatError
from magmatch.number_text import told
from magmatch.typing import Mask, Points, Scalars


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """Poses at strictly increasing times, all in one frame.

    Attributes
    ----------
    times : (n,) array, s
        Strictly increasing; at least two.
    positions : (n, 3) array, m
        Positions of the sensor, survey frame.
    orientations : Rotation of length n
        Takes sensor coordinates to survey coordinates.
    """

    times: Scalars
    positions: Points
    orientations: Rotation

    __repr__ = brief

    def __post_init__(self) -> None:
        positions = points_of(self.positions, "positions", "m", "pose")
        n = len(positions)
        times = column_of(self.times, "times", "s", n, "pose")
        if n < 2:
            msg = f"a trajectory needs at least two poses, got {n}"
            raise ValueError(msg)
        expect_rotations(self.orientations, "orientations", n, "pose")
        require_increasing(times, "pose")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "times", times)

    def __len__(self) -> int:
        return len(self.times)

    def covers(self, times: Scalars) -> Mask:
        """Whether each time lies between the first and the last pose: (k,) bool."""
        return np.asarray((times >= self.times[0]) & (times <= self.times[-1]))

    def interpolate(self, times: Scalars) -> tuple[Points, Rotation]:
        """Poses at other times (k,), s: positions (k, 3), m, interpolated linearly, and orientations, by slerp.

        Raises
        ------
        ValueError
            A time lies outside the trajectory (see `covers`): poses are never extrapolated.

        Notes
        -----
        With ``a = (t - t0) / (t1 - t0)``: ``p = (1 - a) p0 + a p1`` and ``R = R0 Exp(a Log(R0^T R1))`` (slerp).
        """
        outside = ~self.covers(times)
        if outside.any():
            msg = (
                f"{int(outside.sum())} of {len(times)} times lie outside the trajectory's "
                f"{told(self.times[0])} to {told(self.times[-1])} s; drop them first (Trajectory.covers)"
            )
            raise ValueError(msg)
        hit = np.minimum(np.searchsorted(self.times, times), len(self) - 1)
        if np.array_equal(self.times[hit], times):  # the poses themselves, to the bit
            return self.positions[hit], self.orientations[hit]
        positions = np.column_stack([np.interp(times, self.times, axis) for axis in self.positions.T])
        # Between the poses about these times: a log is asked at a few of its thousands again and again.
        after = np.maximum(hit, 1)
        rows = np.union1d(after - 1, after)
        return positions, Slerp(self.times[rows], self.orientations[rows])(times)

    def scaled(self, metre_per_unit: float) -> "Trajectory":
        """Positions in metres, where they came in another unit."""
        if metre_per_unit == 1:
            return self
        return Trajectory(self.times, self.positions * metre_per_unit, self.orientations)

    def save(self, path: str | Path) -> None:
        """Write the trajectory as a TUM file."""
        write_tum(path, self.times, self.positions, self.orientations.as_quat())

    @classmethod
    def load(cls, path: str | Path) -> "Trajectory":
        """Read a TUM file: rows ``t x y z qx qy qz qw``, in seconds and metres, or as its header says.

        Raises
        ------
        DataFormatError
            With the line at fault.
        """
        expect_path(path)
        return cls.from_table(read_ordered(path, TUM_COLUMNS)[0])

    @classmethod
    def from_table(cls, table: Table) -> "Trajectory":
        """Poses of a table's columns, times in s."""
        orientations = table.rotations()
        if orientations is None or len(table) < 2:
            raise DataFormatError(table.path, f"expected at least two poses, found {len(table)}")
        return cls(table.columns["t"], table.stack("x", "y", "z"), orientations)
