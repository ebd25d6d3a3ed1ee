# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch prepare``: correct a raw log, with a report of everything that was done."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Option

from magmatch.cli.command import Layouts, command
from magmatch.cli.narration import say
from magmatch.cli.option_values import numbers, refuse
from magmatch.cli.outputs import check_outputs
from magmatch.cli.settings import merged
from magmatch.errors import ConfigurationError, DataFormatError, SurveyError

if TYPE_CHECKING:
    from magmatch.data.formats.format import SurveyFormat
    from magmatch.preparation.earth_field import Place
    from magmatch.preparation.sensor_model import SensorCorrection

log = logging.getLogger(__name__)

EXAMPLES = (
    "magmatch prepare log.csv --field-unit uT --field-frame sensor --trajectory poses.tum --out survey.csv",
    "magmatch prepare log.csv --out survey.csv --place 48.14,11.58,520 --date 2024-05-01",
    "magmatch prepare log.csv --out survey.csv --config steps.yaml",
    "magmatch prepare phone.zip --trajectory odometry.tum --out survey.csv",
    "magmatch prepare robot.csv --out survey.csv --sensor-from turned_by_hand.csv",
)


@command("prepare", EXAMPLES, surveys=(), reads="LOG")
def prepare(
    layouts: Layouts,
    log: Path = Argument(..., help="Raw log: a survey with orientations.", metavar="LOG"),
    out: Path = Option(..., help="Write the survey here (CSV)."),
    report: Path | None = Option(None, help="Write the report here (JSON); next to the survey by default."),
    config: Path | None = Option(
        None, help="YAML file: thin, recalibration, time_offset, calibration, currents, disturbances, resampling."
    ),
    sensor_from: Path | None = Option(
        None,
        help="Start from a known calibration: the report (JSON) of another log, or a CSV of bx,by,bz (sensor "
        "frame) recorded while rotating the sensor in one place, to which --field-unit, --columns and --recover "
        "apply too.",
    ),
    place: str | None = Option(
        None, help="LAT,LON,HEIGHT in degrees and metres: compare with the Earth's field there."
    ),
    thin: float | None = Option(
        None, min=1e-6, metavar="METRES", help="Take one sample each METRES of the way: for logs of high rates."
    ),
    date: str | None = Option(None, help="Day of the survey, YYYY-MM-DD; goes with --place."),
) -> None:
    """Correct LOG's clock and sensor errors, and check its samples.

    Each step reports its figures before and after. Only significant errors are corrected. Bad samples are flagged,
    and removed only if the configuration says so.
    """
    from magmatch.data.formats.load_trajectory import load_trajectory
    from magmatch.data.read import read_raw_magnetometer, read_survey_and_channels
    from magmatch.preparation.config import PreparationConfig
    from magmatch.preparation.prepare import prepare_either

    if report is None and out.name and out.parent != Path("/dev"):  # a pipe has no folder for the report
        report = out.with_suffix(".json")
    layout = layouts.of()
    check_outputs((out, report), inputs=(log, config, sensor_from, layout.trajectory))
    where = parse_place(place, date)
    settings = merged(PreparationConfig(), config, "preparation")
    settings = settings if thin is None else settings.model_copy(update={"thin": thin})
    survey, channels = read_survey_and_channels(log, layout)
    trajectory = None if layout.trajectory is None else load_trajectory(layout.trajectory, layout)
    known = None if sensor_from is None else read_sensor(sensor_from, layout)
    # A known correction belongs to one of the two magnetometers.
    raw = None if known is not None else read_raw_magnetometer(log, layout)
    prepared, done = prepare_either(
        survey, raw, settings, trajectory=trajectory, channels=channels, place=where, sensor=known
    )
    prepared.save(out)
    if report is not None:
        done.save(report)
    beside = "" if report is None else f", the report to {report}"
    say(f"{done.table()}\nWrote {len(prepared)} of {len(survey)} samples to {out}{beside}")


def parse_place(place: str | None, day: str | None) -> "Place | None":
    """Read place and date, if both are given."""
    from datetime import date

    from magmatch.preparation.earth_field import Place

    if place is None and day is None:
        return None
    if place is None or day is None:
        msg = "--place and --date need each other: the Earth's field depends on place and date"
        raise ConfigurationError(msg)
    latitude, longitude, height = numbers("--place", place, 3, "LAT,LON,HEIGHT in degrees and metres")
    try:
        when = date.fromisoformat(day)
    except ValueError:
        refuse("--date", "YYYY-MM-DD", day)
    return Place(latitude, longitude, height, when)


def read_sensor(path: Path, layout: "SurveyFormat") -> "SensorCorrection":
    """Known correction of the sensor, from a report or a recording made while rotating it."""
    import numpy as np

    from magmatch.data.checks import require_part
    from magmatch.data.diagnoses import of_magnitude
    from magmatch.data.formats.csv import read_columns
    from magmatch.data.sensor_axes import doubt_axes
    from magmatch.data.survey import Survey
    from magmatch.data.survey_columns import FIELD_COLUMNS
    from magmatch.data.tables.text import read_bytes
    from magmatch.data.units import TESLA_PER_UNIT
    from magmatch.preparation.calibrate_in_place import fit_ellipsoid
    from magmatch.preparation.calibration_steps import estimate_text
    from magmatch.preparation.preparation_report import PreparationReport

    if read_bytes(path, 64).lstrip()[:1] == b"{":
        return PreparationReport.load(path).sensor
    table, _ = read_columns(path, layout)
    table.require(FIELD_COLUMNS, "A recording of a rotating sensor needs only these")
    readings = table.stack(*FIELD_COLUMNS) * TESLA_PER_UNIT[layout.field_unit]
    turned = Survey(np.zeros_like(readings), readings, name=str(path))
    require_part(turned, layout)
    try:
        sensor, solution = fit_ellipsoid(readings)
    except SurveyError as error:
        raise DataFormatError(path, str(error)) from None
    for doubt in (*of_magnitude(turned, layout.field_unit), *doubt_axes(turned)):
        log.warning("%s: %s", path, doubt)
    iron, sd, is_open = (part["hard_iron"] for part in (solution.estimate, solution.sd, solution.is_open))
    words = estimate_text("hard_iron", iron, sd, is_open)
    if is_open.any():
        log.warning("%s: hard iron %s; turn it upside down, too", path, words)
    else:
        say(f"{path}: hard iron {words}")
    return sensor
