# SPDX-License-Identifier: BSD-3-Clause
"""What a survey file does not say itself: units, frames, poses from another file."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from magmatch.data.units import FieldUnit, LengthUnit, TimeUnit
from magmatch.errors import ConfigurationError
from magmatch.settings import Settings

COLUMN_NAMES = ("t", "x", "y", "z", "bx", "by", "bz", "qx", "qy", "qz", "qw")


class SurveyFormat(Settings):
    """How to read a survey file; the defaults are the package's own units and frame."""

    field_unit: FieldUnit = Field(default="T", description="Unit of the field (phone logs: uT).")
    length_unit: LengthUnit = Field(default="m", description="Unit of the positions (in a trajectory file too).")
    field_frame: Literal["survey", "sensor"] = Field(
        default="survey",
        description="Frame of the field vectors: the survey's, or the sensor's, which needs orientations. Default "
        "for bags, MCAP and phone logs: sensor, unless they name the survey's frame.",
    )
    time_unit: TimeUnit = Field(default="s", description="Unit of the times in a table.")
    columns: str | None = Field(
        default=None,
        description="Names of a table's columns, if they differ: x=pos_x,bx=mag_x,... A minus reverses: by=-mag_y.",
    )
    trajectory: Path | None = Field(
        default=None,
        description="Take the poses from this TUM (t x y z qx qy qz qw) or EuRoC file, interpolated in time.",
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
        "tf_static, else no offset.",
    )
    recover: bool = Field(
        default=False, description="Read the intact part of a damaged log or survey CSV, and report what was lost."
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

    def column_names(self) -> dict[str, str]:
        """Our names of columns by the file's (lower case), as far as `columns` states them."""
        names = {}
        for pair in () if self.columns is None else self.columns.split(","):
            ours, mark, theirs = (part.strip() for part in pair.replace("=-", "=").partition("="))
            if not mark or ours not in COLUMN_NAMES or not theirs or theirs.lower() in names:
                msg = (
                    f"--columns: expected pairs such as x=pos_x of {', '.join(COLUMN_NAMES)}; found '{pair.strip()}'"
                )
                raise ConfigurationError(msg)
            names[theirs.lower()] = ours
        return names

    def reversed_columns(self) -> tuple[str, ...]:
        """Our names of the columns that `columns` states with a minus."""
        pairs = () if self.columns is None else self.columns.split(",")
        return tuple(pair.split("=")[0].strip() for pair in pairs if "=-" in pair)
