# SPDX-License-Identifier: BSD-3-Clause
"""`read_survey`: read a survey of any format, and check it."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch.arguments import expect_kind, expect_path
from magmatch.data.checks import check_survey
from magmatch.data.formats import csv, parquet
from magmatch.data.formats.csv import read_survey_csv, recording_of_table, survey_of_table
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import EUROC_FIELD, read_euroc, with_poses
from magmatch.data.formats.mat import read_mat
from magmatch.data.formats.parquet import read_parquet
from magmatch.data.formats.phones.phone_log import PhoneLog, Sensor
from magmatch.data.formats.phones.read import read_phone_log, read_phone_recording
from magmatch.data.formats.recording import MAX_CHANNELS, Channels, Recording, TimeSeries
from magmatch.data.formats.sniff import FileKind, sniff
from magmatch.data.logs.read import read_log
from magmatch.data.sensor_axes import missing, without_missing
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import FIELD_COLUMNS
from magmatch.data.tables.pipes import at_rest
from magmatch.data.trajectory import Trajectory
from magmatch.errors import DataFormatError, SurveyError
from magmatch.typing import Scalars

logger = logging.getLogger(__name__)

_NOT_A_SURVEY: Mapping[FileKind, str] = {
    "map": "is a saved map, expected a survey; load it with FieldMap.load, its samples are in .survey",
    "registration": "is a registration result, expected a survey",
    "tum": "holds poses, as rows of 8 numbers or by the names in its header: a TUM trajectory has no field. Expected "
    "a survey CSV with a header row, or columns by number (--columns t=1,x=2,...); pass a trajectory beside it "
    "(--trajectory)",
}


def read_survey(path: str | Path, format: SurveyFormat | None = None) -> Survey:
    """Read a survey file, recognised by its content, and check it.

    Parameters
    ----------
    path : path
        A table (CSV, Parquet, EuRoC), a ROS 1 bag, ROS 2 bag (folder) or MCAP file, or a phone's export.
    format : SurveyFormat, optional
        Units and frames, if other than tesla, metre and survey frame; topics of a log; `recover`.

    Returns
    -------
    Survey
        In tesla and metre, named after the file. Anything suspicious is logged as a warning.

    Raises
    ------
    DataFormatError
        The file does not hold a survey; says where (line, column), what was expected and what was found.
    SurveyError
        It does, but the survey is impossible: wrong units, too few samples.

    Examples
    --------
    >>> import numpy as np, tempfile, pathlib
    >>> from magmatch.data.survey import Survey
    >>> rng = np.random.default_rng(0)
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "room.csv"
    >>> Survey(rng.uniform(0, 3, (50, 3)), rng.normal(28e-6, 2e-6, (50, 3))).save(path)
    >>> len(read_survey(path))
    50
    """
    expect_path(path)
    if format is not None:
        expect_kind(format, "format", (SurveyFormat,), "SurveyFormat(field_unit='uT') makes one")
    return _checked(path, *read_unchecked(path, format or SurveyFormat()))


def read_survey_and_channels(
    path: str | Path, format: SurveyFormat | None = None
) -> tuple[Survey, dict[str, Scalars]]:
    """Read and check a survey, and its log's other numbers (currents, efforts) at the samples, in their own units."""
    layout = format or SurveyFormat()
    if sniff(path) == "log":
        recording = read_log(path, layout, with_channels=True)
        (whole, used), numbers = _joined(path, recording, layout), recording.channels
    else:
        (whole, used), numbers = read_as_written(path, layout), _other_columns(path, layout)
    # Some channels go with the samples row by row.
    is_kept, channels = ~missing(whole), _at_samples(numbers, whole)
    kept = {name: values[is_kept] for name, values in channels.items()}
    return _checked(path, whole if is_kept.all() else whole.subset(is_kept), used), kept


def _other_columns(path: str | Path, layout: SurveyFormat) -> Channels:
    """Read the number columns of a table that are none of a survey's."""
    read = {"csv": csv.read_other_columns, "parquet": parquet.read_other_columns}.get(sniff(path))
    if read is None:
        return {}
    times, columns = read(path, layout, MAX_CHANNELS)
    return {name: TimeSeries(times if layout.rate is None else None, values) for name, values in columns.items()}


def _at_samples(channels: Channels, survey: Survey) -> dict[str, Scalars]:
    """Values for the samples of a survey: by time where there is one, else row by row."""
    found = {}
    for name, channel in channels.items():
        if survey.times is not None and channel.times is not None:
            found[name] = np.interp(survey.times, channel.times, channel.values)
        elif len(channel.values) == len(survey):
            found[name] = channel.values
    return found


def survey_of_phone(log: PhoneLog, layout: SurveyFormat, trajectory: Trajectory) -> Survey:
    """Check the survey of a phone's log with poses that were worked out from it, in metres."""
    survey, used = _read_phone(log.path, layout, trajectory=trajectory, log=log)
    return _checked(log.path, without_missing(survey), used)


def read_raw_magnetometer(path: str | Path, layout: SurveyFormat) -> Survey | None:
    """Read what a phone's magnetometer says without the phone's own calibration; None unless a log holds both."""
    if kind_of(path, layout) != "phone":
        return None
    if len(read_phone_log(path, ("field", "raw_field"), recover=layout.recover).streams) < 2:
        return None
    survey, used = _read_phone(path, layout, "raw_field")
    survey = without_missing(survey)
    try:
        check_survey(replace(survey, name=str(path)), used)
    except SurveyError as error:
        logger.warning("%s; its readings without the phone's own calibration are left aside", error)
        return None
    return survey


def read_poses(path: str | Path, layout: SurveyFormat) -> Trajectory | None:
    """Read a log's poses at their own times; None where each sample has its own, or they are positions only."""
    if sniff(path) == "log":
        recording = read_log(path, layout)
        return recording.trajectory if recording.has_orientations else None
    if layout.trajectory is None:
        return None
    return with_poses(path, np.zeros(0), np.zeros((0, 3)), layout).trajectory


def _checked(path: str | Path, survey: Survey, layout: SurveyFormat) -> Survey:
    """The survey itself; doubts are logged: not of a phone's unit, which is known (see `read_phone_recording`)."""
    is_told = layout.field_unit == "uT" and kind_of(path, layout) == "phone"
    for warning in check_survey(replace(survey, name=str(path)), layout, is_unit_known=is_told):
        logger.warning("%s: %s", path, warning)
    return survey


def read_unchecked(path: str | Path, layout: SurveyFormat) -> tuple[Survey, SurveyFormat]:
    """Read a survey file without checking the survey; also gives how it was read: as stated, and as the file says."""
    survey, used = read_as_written(path, layout)
    return without_missing(survey), used


def read_as_written(path: str | Path, layout: SurveyFormat) -> tuple[Survey, SurveyFormat]:
    """A survey with all readings, those that are missing too."""
    kind = kind_of(path, layout)
    if kind not in READERS:
        raise DataFormatError(path, _NOT_A_SURVEY[kind])
    if layout.rate is not None and kind in {"log", "phone", "euroc", "rostopic"}:
        raise DataFormatError(path, "holds times of its own: leave out --rate")
    survey, used = READERS[kind](path, layout)
    return replace(survey, name=Path(path).name), used


def kind_of(path: str | Path, layout: SurveyFormat) -> FileKind:
    """Tell what a file is by its content; where columns are stated, any text is a table: its user knows it better."""
    kind = sniff(path)
    names_columns = layout.columns and layout.field_axes() is None
    return "csv" if names_columns and kind in {"phone", "tum", "rostopic"} and at_rest(path).is_file() else kind


def _joined(path: str | Path, recording: Recording, layout: SurveyFormat) -> tuple[Survey, SurveyFormat]:
    """Field and poses of a log as a survey."""
    survey = replace(recording.survey(), name=Path(path).name, pose_sd=layout.pose_sd or 0.0)
    return survey, layout.settled(field_frame=recording.field_frame)


def _read_phone(
    path: str | Path,
    layout: SurveyFormat,
    sensor: Sensor | None = None,
    trajectory: Trajectory | None = None,
    log: PhoneLog | None = None,
) -> tuple[Survey, SurveyFormat]:
    """A phone's magnetometer: microtesla in the phone's axes, unless stated otherwise."""
    layout = layout.settled(field_unit="uT", field_frame="sensor")
    return _joined(path, read_phone_recording(path, layout, sensor, trajectory, log), layout)


def _read_euroc(path: str | Path, layout: SurveyFormat) -> tuple[Survey, SurveyFormat]:
    """The magnetometer of an EuRoC folder, or of a topic of ROS as text, which sees vectors in its own frame."""
    table = read_euroc(path, EUROC_FIELD, lone="b", recover=layout.recover)
    if layout.field_axes() is not None:
        turned = dict(zip(FIELD_COLUMNS, layout.turned(table.stack(*FIELD_COLUMNS)).T, strict=True))
        table = replace(table, columns=table.columns | turned)
    return _joined(path, recording_of_table(table, layout.settled(field_frame="sensor")), layout)


Reader = Callable[[str | Path, SurveyFormat], tuple[Survey, SurveyFormat]]
# One entry per format: gives the survey, and how it was read once the file itself has been asked. A new one needs a
# reader here and a signature in `sniff`.
READERS: Mapping[FileKind, Reader] = {
    "csv": lambda path, layout: (read_survey_csv(path, layout), layout),
    "euroc": _read_euroc,
    "rostopic": _read_euroc,
    "parquet": lambda path, layout: (survey_of_table(read_parquet(path, layout), layout), layout),
    "mat": lambda path, layout: (survey_of_table(read_mat(path, layout), layout), layout),
    "phone": _read_phone,
    "log": lambda path, layout: _joined(path, read_log(path, layout), layout),
}
