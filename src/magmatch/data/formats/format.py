# SPDX-License-Identifier: BSD-3-Clause
"""The settings for what a survey file does not say itself: units, frames, poses from another file."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from magmatch.data.tables.number_marks import Decimal
from magmatch.data.units import FieldUnit, LengthUnit, TimeUnit
from magmatch.errors import ConfigurationError
from magmatch.settings import Settings

if TYPE_CHECKING:
    from magmatch.typing import Matrix, Vectors

COLUMN_NAMES = ("t", "x", "y", "z", "bx", "by", "bz", "qx", "qy", "qz", "qw", "lat", "lon", "alt")


class SurveyFormat(Settings):
    """The way to read a survey file; the defaults are the package's own units and frame."""

    field_unit: FieldUnit = Field(default="T", description="Unit of the field (phone logs: uT).")
    length_unit: LengthUnit = Field(
        default="m", description="Unit of the positions that are used: the file's own, or those of --trajectory."
    )
    field_frame: Literal["survey", "sensor"] = Field(
        default="survey",
        description="Frame of the field vectors: the survey's, or the sensor's, which needs orientations. Default "
        "for bags, MCAP and phone logs: sensor, unless they name the survey's frame.",
    )
    time_unit: TimeUnit = Field(
        default="s", description="Unit of the times in a table (those of --trajectory: --trajectory-time-unit)."
    )
    decimal: Decimal | None = Field(
        default=None, description="Decimal mark of a table's numbers, where they leave it in doubt (17,971)."
    )
    columns: str | None = Field(
        default=None,
        description="A table's columns: by name (x=pos_x,bx=mag_x,...), by number, counted from 1 (t=1,bx=2,...), or "
        "one constant for all rows (z=0.0, z=1.20). A minus reverses a column (by=-mag_y); of a bag or a phone's log "
        "it reverses an axis (by=-by).",
    )
    rate: float | None = Field(default=None, gt=0, description="Samples per second of a table without times.")
    origin: str | None = Field(
        default=None,
        description="LATITUDE,LONGITUDE[,ALTITUDE]: where columns lat, lon, alt are x = y = z = 0, in metres east, "
        "north and up. Default: near the first sample.",
    )
    trajectory: Path | None = Field(
        default=None,
        description="Take the poses from this file, interpolated in time: TUM (t x y z qx qy qz qw), EuRoC, Motive, "
        "or a table whose header names these columns.",
    )
    trajectory_time_unit: TimeUnit = Field(
        default="s", description="Unit of the times in the TUM file of --trajectory."
    )
    mag_topic: str | None = Field(default=None, description="Topic of the field, if a log has several.")
    pose_topic: str | None = Field(default=None, description="Topic of the poses, if a log has several.")
    pose_frames: str | None = Field(
        default=None, description="Take the poses from tf: of the second frame in the first, such as map,base_link."
    )
    extrinsic: str | None = Field(
        default=None,
        description="Pose of the magnetometer on the body whose poses are given: 'x y z qx qy qz qw' (metres; "
        "takes sensor to body coordinates) or a YAML file with translation and rotation. Default: from "
        "tf or the robot's description, else no offset.",
    )
    recover: bool = Field(
        default=False,
        description="Read the intact part of a damaged log or table (of Parquet: rows that hold numbers), and of "
        "--trajectory, and report what was lost.",
    )
    # None: the file's value (files written by this package have one), else 0, which means unknown or exact.
    pose_sd: float | None = Field(
        default=None, ge=0, description="Standard deviation of the survey's own positions, metres."
    )

    def settled(self, **found: Any) -> "SurveyFormat":
        """Return this format with the file's own values for all settings that were not given."""
        return self.model_copy(
            update={key: value for key, value in found.items() if key not in self.model_fields_set}
        )

    def stated_columns(self) -> dict[str, str]:
        """Read `columns`: for our names of columns the file's name (lower case), a number or a constant."""
        return {ours: text for ours, (text, _) in self._columns().items()}

    def field_axes(self) -> "Matrix | None":
        """The sensor's axes by those that are read (by=-by), where `columns` states nothing else: (3, 3)."""
        import numpy as np  # late for help

        ours = ("bx", "by", "bz")
        stated = dict(zip(ours, ours, strict=True)) | self.stated_columns()
        if self.columns is None or sorted(stated.values()) != list(ours):
            return None
        axes = np.eye(3)[[ours.index(stated[name]) for name in ours]]
        signs = [[-1.0 if name in self.reversed_columns() else 1.0] for name in ours]
        return np.asarray(axes * np.array(signs))

    def turned(self, field: "Vectors") -> "Vectors":
        """Vectors of a log, which has no columns, in the axes that `columns` states."""
        if self.columns is None:
            return field
        if (axes := self.field_axes()) is None:
            msg = f"--columns: a log has none; expected ways of its axes such as by=-by, found '{self.columns}'"
            raise ConfigurationError(msg)
        turned: Vectors = field @ axes.T
        return turned

    def reversed_columns(self) -> tuple[str, ...]:
        """Our names of the columns that `columns` states with a minus."""
        return tuple(ours for ours, (_, is_reversed) in self._columns().items() if is_reversed)

    def _columns(self) -> dict[str, tuple[str, bool]]:
        """Read `columns`; a minus before the number of a column that may be constant is the constant's."""
        from magmatch.data.survey_columns import MAY_BE_CONSTANT, constant_of  # numpy is late for help

        stated: dict[str, tuple[str, bool]] = {}
        for pair in () if self.columns is None else self.columns.split(","):
            ours, mark, theirs = (part.strip() for part in pair.partition("="))
            if not mark or ours not in COLUMN_NAMES or not theirs or ours in stated:
                expected = f"pairs such as x=pos_x of {', '.join(COLUMN_NAMES)}"
                msg = f"--columns: expected {expected}; found '{pair.strip()}'"
                raise ConfigurationError(msg)
            is_constant = ours in MAY_BE_CONSTANT and constant_of(theirs) is not None
            is_reversed = theirs.startswith("-") and not is_constant
            stated[ours] = theirs.removeprefix("-" * is_reversed).lower(), is_reversed
        return stated
