# SPDX-License-Identifier: BSD-3-Clause
"""The first noun: a survey, samples of the magnetic field at known positions."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.geometry import rotate_vectors, transform_points
from magmatch.typing import Points, Scalars, Vector3, Vectors


@dataclass(frozen=True, eq=False, slots=True)
class Survey:
    """Samples of the magnetic field at known positions, all in one frame.

    Attributes
    ----------
    positions : (n, 3) array, m
        Where the samples were taken, survey frame.
    field : (n, 3) array, T
        Field vectors, survey frame (readers turn sensor-frame vectors once, at the door).
    times : (n,) array, s, optional
        Strictly increasing when present.
    orientations : Rotation of length n, optional
        Takes sensor coordinates to survey coordinates.
    frame : str
        Name of the survey frame.
    name : str
        Where the survey came from, for messages and reports.
    pose_sd : float, m
        Standard deviation of the survey's own positions; 0 where unknown or exact.
    """

    positions: Points
    field: Vectors
    times: Scalars | None = None
    orientations: Rotation | None = None
    frame: str = "survey"
    name: str = "survey"
    pose_sd: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.positions)
        if self.positions.shape != (n, 3) or self.field.shape != (n, 3):
            msg = f"positions and field must both be (n, 3), got {self.positions.shape} and {self.field.shape}"
            raise ValueError(msg)
        for label, rows in (("times", self.times), ("orientations", self.orientations)):
            if rows is not None and len(rows) != n:
                msg = f"{label} must have one row per sample: expected {n}, got {len(rows)}"
                raise ValueError(msg)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def centroid(self) -> Vector3:
        """Mean position, m."""
        return np.asarray(self.positions.mean(axis=0))

    def transformed(self, T_new_survey: RigidTransform, frame: str | None = None) -> "Survey":
        """Return the same samples in another frame: positions move, vectors turn.

        Parameters
        ----------
        T_new_survey : RigidTransform
            Takes survey coordinates to the new frame.
        frame : str, optional
            Name of the new frame; unchanged by default.

        Returns
        -------
        Survey
            New survey; times, name and accuracy are kept.
        """
        turned = None if self.orientations is None else T_new_survey.rotation * self.orientations
        return replace(
            self,
            positions=transform_points(self.positions, T_new_survey),
            field=rotate_vectors(self.field, T_new_survey),
            orientations=turned,
            frame=frame or self.frame,
        )

    def subset(self, rows: np.ndarray) -> "Survey":
        """Return the samples chosen by a mask or by indices, in that order.

        Parameters
        ----------
        rows : (n,) bool or (k,) int array
            Which samples to keep.

        Returns
        -------
        Survey
            New survey of the chosen samples.
        """
        return replace(
            self,
            positions=self.positions[rows],
            field=self.field[rows],
            times=None if self.times is None else self.times[rows],
            orientations=None if self.orientations is None else self.orientations[rows],
        )

    def merged(self, *others: "Survey") -> "Survey":
        """Join surveys that share this one's frame; times and orientations stay only where all have them.

        Parameters
        ----------
        *others : Survey
            Surveys in the same frame.

        Returns
        -------
        Survey
            All samples, in the order given; times are dropped, since separate surveys' clocks need not agree.
        """
        if not others:
            return self
        parts = (self, *others)
        orientations = [s.orientations for s in parts if s.orientations is not None]
        return Survey(
            positions=np.concatenate([s.positions for s in parts]),
            field=np.concatenate([s.field for s in parts]),
            orientations=reduce(_concatenate, orientations) if len(orientations) == len(parts) else None,
            frame=self.frame,
            name="+".join(s.name for s in parts),
            pose_sd=max(s.pose_sd for s in parts),
        )

    def principal_frame(self) -> RigidTransform:
        """Frame laid along the samples' principal axes, moving with the survey: ``T_survey_principal``.

        Axes are ordered from longest to shortest and signed by the skewness of the samples along them (by the
        mean field where that vanishes), so that the frame follows every rigid motion of the survey.

        Returns
        -------
        RigidTransform
            Takes principal coordinates to survey coordinates; its origin is the centroid.
        """
        offset = self.positions - self.centroid
        _, axes = np.linalg.eigh(offset.T @ offset / len(self))
        R = axes[:, ::-1].copy()
        along = offset @ R
        skewness = (along**3).mean(axis=0)
        spread = (along**2).mean(axis=0) ** 1.5
        lean = self.field.mean(axis=0) @ R
        is_skewed = np.abs(skewness) > 1e-6 * np.maximum(spread, np.finfo(float).tiny)
        sign = np.where(np.where(is_skewed, skewness, lean) < 0, -1.0, 1.0)
        R *= sign
        R[:, 2] = np.cross(R[:, 0], R[:, 1])
        return RigidTransform.from_components(self.centroid, Rotation.from_matrix(R))


def _concatenate(first: Rotation, second: Rotation) -> Rotation:
    return Rotation.concatenate([first, second])
