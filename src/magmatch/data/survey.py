# SPDX-License-Identifier: BSD-3-Clause
"""`Survey`: samples of the magnetic field at known positions."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from dataclasses import field as field_of
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.arguments import (
    column_of,
    expect_kind,
    expect_path,
    expect_rotations,
    expect_transform,
    number_of,
    points_of,
    require_finite,
    require_increasing,
    rows_chosen,
)
from magmatch.data.dataframes import frame_of_xarray, table_of_frame
from magmatch.data.survey_columns import (
    COLUMNS,
    DEFAULT_FRAME,
    FIELD_COLUMNS,
    FRAME_COLUMN,
    POSITION_COLUMNS,
    FieldFrame,
    stated_columns,
    survey_arguments,
)
from magmatch.data.surveyed_points import SurveyedPoints
from magmatch.data.tables.table import QUATERNION, Table, Wanted, read_table, write_table
from magmatch.data.units import FieldUnit, LengthUnit, TimeUnit, field_text
from magmatch.errors import SurveyError, in_short
from magmatch.geometry import principal_frame, rotate_vectors, transform_points
from magmatch.picture import coloured_points, with_picture
from magmatch.typing import Mask, Points, Scalars, Vector3, Vectors

# Of a path, a row's next one is nearer than two rows at random are (rms); of rows in no order it is about as far.
LARGEST_STEP = 0.6


@dataclass(frozen=True, eq=False, slots=True)
class Survey:
    """Samples of the magnetic field at known positions, all in one frame.

    Attributes
    ----------
    positions : (n, 3) array, m
        Where the samples were taken, survey frame.
    field : (n, 3) array, T
        Field vectors, survey frame (readers rotate vectors in the sensor's frame once).
    times : (n,) array, s, optional
        Strictly increasing when present.
    orientations : Rotation of length n, optional
        Takes sensor coordinates to survey coordinates.
    frame : str
        Name of the survey frame.
    name : str
        Where the survey came from, for messages and reports.
    pose_sd : float, m
        Standard deviation of the survey's own positions; 0 if unknown or exact.
    waypoints : SurveyedPoints, optional
        Points of a plan that a phone's walker marked, at times of the survey but in the plan's frame: `slam` has
        them as fixed points. They are in no table or map that is saved.
    is_dead_reckoned : bool
        Whether the positions are a phone's dead reckoning, which drifts more than a robot's odometry: `localize` then
        has another default. It is in no table or map that is saved.
    """

    positions: Points
    field: Vectors
    times: Scalars | None = None
    orientations: Rotation | None = None
    frame: str = DEFAULT_FRAME
    name: str = "survey"
    pose_sd: float = 0.0
    waypoints: SurveyedPoints | None = field_of(default=None, metadata={"is_saved": False})
    is_dead_reckoned: bool = field_of(default=False, metadata={"is_saved": False})

    def __post_init__(self) -> None:
        expect_kind(self.name, "name", (str,))
        expect_kind(self.frame, "frame", (str,))
        with _faults_of(self.name):
            settled = self._settled()
        for name, values in settled.items():
            object.__setattr__(self, name, values)

    def _settled(self) -> dict[str, np.ndarray]:
        """The arrays as float64, once they are fit for it."""
        settled = {"positions": points_of(self.positions, "positions", "m", "sample")}
        settled["field"] = points_of(self.field, "field", "T", "sample")
        n = len(settled["positions"])
        if not n or len(settled["field"]) != n:
            shapes = f"{settled['positions'].shape} and {settled['field'].shape}"
            msg = f"positions and field must both be (n, 3), with n at least 1, got {shapes}; give a field for each"
            raise ValueError(msg)
        if self.times is not None:
            settled["times"] = column_of(self.times, "times", "s", n)
            require_increasing(settled["times"])
        if self.orientations is not None:
            expect_rotations(self.orientations, "orientations", n)
        number_of(self.pose_sd, "pose_sd", "m")
        if self.waypoints is not None:
            expect_kind(self.waypoints, "waypoints", (SurveyedPoints,))
        return settled

    def check(self) -> None:
        """Raise SurveyError if samples are not finite or times do not increase: arrays may have been changed."""
        with _faults_of(self.name):
            require_finite(self.positions, "positions")
            require_finite(self.field, "field")
            if self.times is not None:
                require_finite(self.times, "times")
                require_increasing(self.times)

    def __repr__(self) -> str:
        if not len(self):
            return f"Survey {self.name!r}: no samples"
        size = " x ".join(f"{side:.3g}" for side in np.ptp(self.positions, axis=0))
        magnitude = np.linalg.norm(self.field, axis=1)
        low, middle, high = (field_text(v) for v in np.quantile(magnitude, [0, 0.5, 1]))
        also = [] if self.times is None else [f"{self.times[-1] - self.times[0]:.4g} s"]
        also += [] if self.orientations is None else ["orientations"]
        return (
            f"Survey {self.name!r}: {len(self)} samples over {size} m, frame {self.frame!r}\n"
            f"|B| {low} to {high}, median {middle}{'; ' if also else ''}{', '.join(also)}"
        )

    def _repr_html_(self) -> str:
        return with_picture(repr(self), self.picture())

    def picture(self) -> str:
        """Samples coloured by field magnitude: inline SVG."""
        title = f"samples of {self.name}, coloured by field magnitude"
        return coloured_points(self.positions, np.linalg.norm(self.field, axis=1), title)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def centroid(self) -> Vector3:
        """Mean position, m."""
        return np.asarray(self.positions.mean(axis=0))

    def transformed(self, T_new_survey: RigidTransform, frame: str | None = None) -> "Survey":
        """Return the same samples in another frame: positions are transformed, vectors rotated.

        ``T_new_survey`` takes survey coordinates to the new frame; its name is unchanged by default.
        """
        expect_transform(T_new_survey, "T_new_survey")
        turned = None if self.orientations is None else T_new_survey.rotation * self.orientations
        return self._with(
            positions=transform_points(self.positions, T_new_survey),
            field=rotate_vectors(self.field, T_new_survey),
            orientations=turned,
            frame=frame or self.frame,
        )

    def subset(self, rows: np.ndarray) -> "Survey":
        """Return the samples chosen by a mask (n,) or by indices (k,), in that order; there may be none."""
        rows = rows_chosen(rows, len(self))
        return self._with(
            positions=self.positions[rows],
            field=self.field[rows],
            times=None if self.times is None else self.times[rows],
            orientations=None if self.orientations is None else self.orientations[rows],
        )

    def merged(self, *others: "Survey") -> "Survey":
        """Join surveys that share this one's frame, in the order given; orientations are kept only if all have them.

        Times are dropped, since separate surveys' clocks need not agree.
        """
        if not others:
            return self
        for other in others:
            expect_kind(other, "merged", (Survey,))
        parts = (self, *others)
        orientations = [s.orientations for s in parts if s.orientations is not None]
        return Survey(
            positions=np.concatenate([s.positions for s in parts]),
            field=np.concatenate([s.field for s in parts]),
            orientations=Rotation.concatenate(orientations) if len(orientations) == len(parts) else None,
            frame=self.frame,
            name="+".join(in_short([s.name for s in parts])),
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

        An existing file is replaced only once the new one is complete.
        """
        write_table(path, stated_columns(self.columns(), len(self), self.frame, self.pose_sd))

    @classmethod
    def load(cls, path: str | Path) -> "Survey":
        """Read a survey CSV in tesla, metre and survey frame; `magmatch.read_survey` also converts and checks.

        Raises
        ------
        DataFormatError
            With line and column wherever one is at fault.
        """
        expect_path(path)
        return cls.from_table(read_table(path, Wanted(COLUMNS, words=(FRAME_COLUMN,))))

    @classmethod
    def from_dataframe(
        cls,
        df: Any,
        field_unit: FieldUnit = "T",
        length_unit: LengthUnit = "m",
        time_unit: TimeUnit = "s",
        columns: Mapping[str, str] | None = None,
        *,
        field_frame: FieldFrame = "survey",
        frame: str | None = None,
        name: str = "DataFrame",
        pose_sd: float | None = None,
        origin: str | None = None,
    ) -> "Survey":
        """Survey from a DataFrame (pandas, polars) with the columns of the survey CSV, rows in the given order.

        Parameters
        ----------
        df : DataFrame
            Columns ``x, y, z, bx, by, bz``, and ``t, qx, qy, qz, qw`` where known; others are ignored, and so is an
            index, unless it is named as one of them, or there is no ``t`` and it holds increasing dates. Times may
            be dates; ``lat, lon, alt`` (degrees, m) stand for ``x, y, z``.
        field_unit, length_unit, time_unit : str
            Units of the numbers: ``"uT"``, ``"mm"``, ``"ms"`` and so on.
        columns : dict of str to str, optional
            Names of columns, if they differ: ``{"x": "pos_x", "bx": "mag_x"}``.
        field_frame : {"survey", "sensor"}
            Frame of the field vectors; the sensor's needs orientations.
        frame, name, pose_sd : optional
            See `Survey`; by default frame and accuracy are what columns ``survey_frame`` and ``pose_sd`` say.
        origin : str, optional
            ``"LATITUDE,LONGITUDE,ALTITUDE"`` at which x = y = z = 0, of samples with latitude and longitude; by
            default near the first.

        Raises
        ------
        DataFormatError
            A column is missing, or holds no numbers.
        SurveyError
            A number is missing, or the survey is impossible.

        Examples
        --------
        >>> import pandas as pd
        >>> df = pd.DataFrame({"x": [0, 1], "y": 0, "z": 1, "bx": [20, 21], "by": 0, "bz": -45})
        >>> Survey.from_dataframe(df, "uT").field[1].round(8).tolist()
        [2.1e-05, 0.0, -4.5e-05]
        """
        table = table_of_frame(df, name, time_unit, columns or {})
        survey = cls.from_table(table, field_unit, length_unit, field_frame, origin)
        pose_sd = survey.pose_sd if pose_sd is None else pose_sd
        return replace(survey, frame=frame or survey.frame, name=name, pose_sd=pose_sd)

    @classmethod
    def from_xarray(
        cls,
        dataset: Any,
        field_unit: FieldUnit | None = None,
        length_unit: LengthUnit | None = None,
        time_unit: TimeUnit | None = None,
        columns: Mapping[str, str] | None = None,
        *,
        field_frame: FieldFrame = "survey",
        frame: str | None = None,
        name: str = "Dataset",
        pose_sd: float | None = None,
        origin: str | None = None,
    ) -> "Survey":
        """Survey from an xarray Dataset, with variables or coordinates named as the columns of the survey CSV.

        Parameters
        ----------
        dataset : xarray.Dataset
            Samples along one dimension, or a grid, of which every point becomes a sample.
        field_unit, length_unit, time_unit : str, optional
            By default what the variables' attribute ``units`` says, else T, m and s.
        columns, field_frame, frame, name, pose_sd, origin
            See `from_dataframe`.

        Raises
        ------
        DataFormatError
            A variable is missing, holds no numbers, or is in a unit that is not known.
        SurveyError
            A number is missing, or no survey has such numbers.
        """
        table, said = frame_of_xarray(dataset, columns or {})
        units: tuple[Any, Any, Any] = (
            field_unit or said.get("bx", "T"),
            length_unit or said.get("x", "m"),
            time_unit or said.get("t", "s"),
        )
        return cls.from_dataframe(
            table, *units, columns, field_frame=field_frame, frame=frame, name=name, pose_sd=pose_sd, origin=origin
        )

    @classmethod
    def from_table(
        cls,
        table: Table,
        field_unit: FieldUnit = "T",
        length_unit: LengthUnit = "m",
        field_frame: FieldFrame = "survey",
        origin: str | None = None,
    ) -> "Survey":
        """Survey of a table's columns, times in s, named after the file."""
        return cls(**survey_arguments(table, field_unit, length_unit, field_frame, origin))

    def _with(self, **changes: Any) -> "Survey":
        """Give the survey with some of its parts changed, which were checked before; it may be empty."""
        survey: Survey = object.__new__(type(self))
        for f in fields(self):
            object.__setattr__(survey, f.name, changes[f.name] if f.name in changes else getattr(self, f.name))
        return survey

    def principal_frame(self) -> RigidTransform:
        """Frame laid along the samples' principal axes, moving with the survey: ``T_survey_principal``.

        Its origin is the centroid; signed by skewness, or the mean field, it follows every rigid motion of them.
        """
        return principal_frame(self.positions, self.field.mean(axis=0))


def has_order(survey: Survey) -> bool:
    """Whether the rows are a path: with times they are; else steps are compared with the size of the whole.

    Lines through other rows, and lengths along them, mean nothing.
    """
    if survey.times is not None:
        return True
    if len(survey) < 2:
        return False
    p = survey.positions
    step = np.median(np.linalg.norm(np.diff(p, axis=0), axis=1))
    return bool(step <= LARGEST_STEP * np.sqrt(2 * p.var(axis=0).sum()))


def subsets(surveys: tuple[Survey, ...], kept: Mask) -> tuple[Survey, ...]:
    """Surveys without some of their samples (a mask over all, in order), and without those of which none is left."""
    ends = np.cumsum([0, *(len(survey) for survey in surveys)])
    parts = (survey.subset(kept[a:b]) for survey, (a, b) in zip(surveys, pairwise(ends), strict=True))
    return tuple(part for part in parts if len(part))


@contextmanager
def _faults_of(name: str) -> Iterator[None]:
    """Checks whose errors name the survey."""
    try:
        yield
    except ValueError as error:
        msg = f"{name}: {error}"
        raise SurveyError(msg) from None
