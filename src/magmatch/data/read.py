# SPDX-License-Identifier: BSD-3-Clause
"""The verb of this room: read a survey, whatever the format, and check that it can be one."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from magmatch.data.checks import check_survey
from magmatch.data.csv import read_survey_csv
from magmatch.data.format import SurveyFormat
from magmatch.data.sniff import FileKind, sniff
from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError

logger = logging.getLogger(__name__)

# One entry per format; a new one needs a reader here and a signature in `sniff`.
READERS: Mapping[FileKind, Callable[[str | Path, SurveyFormat], Survey]] = {"csv": read_survey_csv}

_NOT_A_SURVEY: Mapping[FileKind, str] = {
    "map": "is a saved map, expected a survey; load it with FieldMap.load, its samples are in .survey",
    "registration": "is a registration result, expected a survey",
    "tum": "holds rows of 8 numbers without a header: a TUM trajectory has no field. Expected a survey CSV with a "
    "header row; pass the trajectory beside it (--trajectory)",
}


def read_survey(path: str | Path, format: SurveyFormat | None = None) -> Survey:
    """Read a survey file, told by its content, and check it.

    Parameters
    ----------
    path : path
        The file.
    format : SurveyFormat, optional
        Units and frames, where the file differs from tesla, metre and survey frame.

    Returns
    -------
    Survey
        In tesla and metre, named after the file. Doubts that do not forbid its use are logged as warnings.

    Raises
    ------
    DataFormatError
        The file does not hold a survey; says where (line, column), what was expected and what was found.
    SurveyError
        It does, but no such survey can be: wrong units, too few samples.

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
    layout = format or SurveyFormat()
    kind = sniff(path)
    if kind not in READERS:
        raise DataFormatError(path, _NOT_A_SURVEY[kind])
    survey = READERS[kind](path, layout)
    for warning in check_survey(replace(survey, name=str(path)), layout):
        logger.warning("%s: %s", path, warning)
    return replace(survey, name=Path(path).name)
