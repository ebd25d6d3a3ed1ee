# SPDX-License-Identifier: BSD-3-Clause
"""Write a survey in other programs' formats: CSV, Parquet, MCAP, TUM, PLY, VTK."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from magmatch.data.formats.parquet import write_parquet
from magmatch.data.logs.write_mcap import write_mcap
from magmatch.data.points import write_ply, write_vtk_points
from magmatch.data.survey import Survey
from magmatch.data.trajectory import Trajectory
from magmatch.errors import SurveyError


def write_tum_of(survey: Survey, path: str | Path) -> None:
    """Write the poses of a survey as a TUM trajectory."""
    if survey.times is None or survey.orientations is None:
        missing = "times" if survey.times is None else "orientations"
        msg = f"{survey.name}: has no {missing}, which a TUM trajectory needs"
        raise SurveyError(msg)
    Trajectory(survey.times, survey.positions, survey.orientations).save(path)


def _write_ply(survey: Survey, path: str | Path) -> None:
    write_ply(path, survey.positions, {"b": survey.field})


def _write_vtk(survey: Survey, path: str | Path) -> None:
    magnitude = np.linalg.norm(survey.field, axis=1)
    write_vtk_points(path, survey.positions, {"field": survey.field, "magnitude": magnitude})


# By the ending of the file's name.
SURVEY_WRITERS: Mapping[str, Callable[[Survey, str | Path], None]] = {
    ".csv": Survey.save,
    ".parquet": write_parquet,
    ".mcap": write_mcap,
    ".tum": write_tum_of,
    ".ply": _write_ply,
    ".vtk": _write_vtk,
}
