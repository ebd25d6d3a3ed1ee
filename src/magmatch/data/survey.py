# SPDX-License-Identifier: BSD-3-Clause
"""The first noun: a survey, samples of the magnetic field at known positions."""

import json
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.tables.quaternions import QUATERNION, rotations_of
from magmatch.data.tables.table import Table, read_table, write_table
from magmatch.errors import DataFormatError
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.typing import Mask, Points, Scalars, Vector3, Vectors

POSITION_COLUMNS = ("x", "y", "z")
FIELD_COLUMNS = ("bx", "by", "bz")
COLUMNS = ("t", *POSITION_COLUMNS, *FIELD_COLUMNS, *QUATERNION)
# First comment of files written here: what the columns cannot say (frame, pose_sd) follows as JSON.
SCHEMA = "magmatch.survey/1"


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

    def columns(self) -> dict[str, Scalars]:
        """Columns of a table of the samples, by name: ``t, x, y, z, bx, by, bz, qx, qy, qz, qw``, as far as known."""
        columns = {} if self.times is None else {"t": self.times}
        columns |= dict(zip(POSITION_COLUMNS, self.positions.T, strict=True))
        columns |= dict(zip(FIELD_COLUMNS, self.field.T, strict=True))
        if self.orientations is not None:
            columns |= dict(zip(QUATERNION, self.orientations.as_quat().T, strict=True))
        return columns

    def save(self, path: str | Path) -> None:
        """Write the survey CSV (tesla, metre, survey frame); reading it back gives the same float64 values.

        Parameters
        ----------
        path : path
            Where; an existing file is replaced only once the new one is complete.
        """
        columns = self.columns()
        about = {"frame": self.frame, "pose_sd": float(self.pose_sd)}
        write_table(path, columns, [f"{SCHEMA} {json.dumps(about)}"])

    @classmethod
    def load(cls, path: str | Path) -> "Survey":
        """Read a survey CSV in tesla, metre and survey frame; `magmatch.read_survey` also converts and checks.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Survey

        Raises
        ------
        DataFormatError
            With line and column wherever one is at fault.
        """
        return cls.from_table(read_table(path, COLUMNS))

    @classmethod
    def from_table(cls, table: Table) -> "Survey":
        """Survey of a table's columns, as they stand, named after the file."""
        table.require([*POSITION_COLUMNS, *FIELD_COLUMNS])
        if table.has("t"):
            table.require_increasing("t")
        return cls(
            positions=table.stack(*POSITION_COLUMNS),
            field=table.stack(*FIELD_COLUMNS),
            times=table.columns.get("t"),
            orientations=rotations_of(table),
            name=table.path.name,
            **_about(table),
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


def subsets(surveys: tuple[Survey, ...], kept: Mask) -> tuple[Survey, ...]:
    """Surveys without some of their samples (a mask over all, in order), and without those of which none is left."""
    ends = np.cumsum([0, *(len(survey) for survey in surveys)])
    parts = (survey.subset(kept[a:b]) for survey, (a, b) in zip(surveys, pairwise(ends), strict=True))
    return tuple(part for part in parts if len(part))


def _concatenate(first: Rotation, second: Rotation) -> Rotation:
    return Rotation.concatenate([first, second])


def _about(table: Table) -> dict[str, Any]:
    """Frame and accuracy, where the file was written by `Survey.save`."""
    text = next((c.removeprefix(SCHEMA) for c in table.comments if c.startswith(SCHEMA)), "{}")
    try:
        about = json.loads(text)
        frame, pose_sd = str(about.get("frame", "survey")), float(about.get("pose_sd", 0.0))
    except (ValueError, TypeError, AttributeError):
        pose_sd = -1.0
    if not 0 <= pose_sd < np.inf:
        message = (
            f'expected {SCHEMA} {{"frame": ..., "pose_sd": ...}} in its first comment, found {text.strip()[:60]}'
        )
        raise DataFormatError(table.path, message)
    return {"frame": frame, "pose_sd": pose_sd}
