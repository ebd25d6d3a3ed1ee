# SPDX-License-Identifier: BSD-3-Clause
"""A recording: field samples and poses on one clock, before they are joined into a survey."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as field_of
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError
from magmatch.number_text import many, told
from magmatch.typing import Scalars, Vectors

logger = logging.getLogger(__name__)

# Bound, stated in docs/formats.md: a robot's currents are a few; each costs three unknowns.
MAX_CHANNELS = 64


@dataclass(frozen=True, eq=False, slots=True)
class TimeSeries:
    """Numbers over time."""

    # (n,), s: on the survey's clock, not decreasing; None where values stand row by row beside the samples
    times: Scalars | None
    values: Scalars  # (n,): in the file's own unit


# The numbers of a log beside field and poses, by name.
Channels = Mapping[str, TimeSeries]


@dataclass(frozen=True, eq=False, slots=True)
class Recording:
    """A log: the field at its own times, the poses at theirs."""

    path: Path  # where it came from
    times: Scalars  # (n,), s: of the field samples, strictly increasing
    field: Vectors  # (n, 3), T: in the frame that `field_frame` says
    # Poses on the same clock; of the sensor, once `T_body_sensor` has been applied by `carried`
    trajectory: Trajectory
    field_frame: Literal["sensor", "survey"] = "sensor"  # frame of the field vectors
    has_orientations: bool = True  # False where the poses are positions only (the trajectory then holds identities)
    frame: str = "survey"  # name of the survey frame
    poses_from: Path | None = None  # another file that the poses came from
    channels: Channels = field_of(default_factory=dict)  # other numbers of the log, where they were asked for
    waypoints: SurveyedPoints | None = None

    def carried(self, T_body_sensor: RigidTransform | None) -> "Recording":
        """Turn poses of the carrying body into poses of the sensor."""
        if T_body_sensor is None:
            return self
        body = self.trajectory
        lever = body.orientations.apply(np.asarray(T_body_sensor.translation))
        poses = Trajectory(body.times, body.positions + lever, body.orientations * T_body_sensor.rotation)
        return replace(self, trajectory=poses)

    def survey(self) -> Survey:
        """Join: each field sample at the pose interpolated to its time, its vector in the survey frame."""
        if self.field_frame == "sensor" and not self.has_orientations:
            message = "the poses are positions only, so field vectors in the sensor's frame cannot be turned"
            raise DataFormatError(self.path, message)
        is_covered = self._covered()
        kept, field = self.times[is_covered], self.field[is_covered]
        self._warn_of_pose_gaps(kept)
        positions, orientations = self.trajectory.interpolate(kept)
        return Survey(
            positions,
            orientations.apply(field) if self.field_frame == "sensor" else field,
            kept,
            orientations if self.has_orientations else None,
            frame=self.frame,
            name=self.path.name,
            waypoints=self.waypoints,
        )

    def _covered(self) -> np.ndarray:
        """Samples within the trajectory; others are counted in a warning, and none at all is an error."""
        times, poses = self.times, self.trajectory
        is_covered = poses.covers(times)
        n_covered = int(is_covered.sum())
        if n_covered == 0:
            span = _span(times) if len(times) else "nothing"
            message = (
                f"no sample lies within the trajectory: the field covers {span}, "
                f"{f'{self.poses_from} covers' if self.poses_from else 'the poses cover'} {_span(poses.times)}; "
                "both need the same clock"
            )
            raise DataFormatError(self.path, message, column="t")
        if n_covered < len(times):
            n_dropped, n_before = len(times) - n_covered, int((times < poses.times[0]).sum())
            # Two sensors that start and stop together still read up to an interval apart.
            usual = max(float(np.median(np.diff(times))), float(np.median(np.diff(poses.times))))
            is_news = max(poses.times[0] - times[0], times[-1] - poses.times[-1]) > usual
            logger.log(
                logging.WARNING if is_news else logging.INFO,
                "%s: dropped %d of %d samples without a pose (%d before the trajectory begins, %d after it ends)",
                self.path, n_dropped, len(times), n_before, n_dropped - n_before,
            )  # fmt: skip
        return is_covered

    def _warn_of_pose_gaps(self, times: Scalars) -> None:
        """Say where poses are interpolated across a hole in the trajectory."""
        intervals = np.diff(self.trajectory.times)
        limit = max(1.0, 10 * float(np.median(intervals)))
        before = np.clip(np.searchsorted(self.trajectory.times, times, side="right") - 1, 0, len(intervals) - 1)
        n_in_gaps = int((intervals[before] > limit).sum())
        if n_in_gaps:
            logger.warning(
                "%s: %s in gaps of the trajectory longer than %.3g s; their poses are interpolated",
                self.path, many(n_in_gaps, "sample") + (" lies" if n_in_gaps == 1 else " lie"), limit,
            )  # fmt: skip


def _span(times: Scalars) -> str:
    """First and last time, in milliseconds unless these are the same."""
    first, last = (f"{t:.3f}" for t in times[[0, -1]])
    return f"{first} to {last} s" if first != last else f"{told(times[0])} to {told(times[-1])} s"
