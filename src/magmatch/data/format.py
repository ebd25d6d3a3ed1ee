# SPDX-License-Identifier: BSD-3-Clause
"""What a survey file means where it does not say so itself: units, frames, poses from elsewhere."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from magmatch.data.units import FieldUnit, LengthUnit


class SurveyFormat(BaseModel):
    """How to read a survey file; the defaults are the package's own units and frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    field_unit: FieldUnit = Field(default="T", description="Unit of the field columns.")
    length_unit: LengthUnit = Field(default="m", description="Unit of the positions (in a trajectory file too).")
    field_frame: Literal["survey", "sensor"] = Field(
        default="survey",
        description="Frame of the field vectors: already turned into the survey's frame, or as the sensor saw them, "
        "which needs orientations.",
    )
    trajectory: Path | None = Field(
        default=None, description="Take the poses from this TUM file (t x y z qx qy qz qw), interpolated in time."
    )
    # None: what the file says (files written by this package do), else 0, that is unknown or exact.
    pose_sd: float | None = Field(
        default=None, ge=0, description="Standard deviation of the survey's own positions, metres."
    )
