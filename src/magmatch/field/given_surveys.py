# SPDX-License-Identifier: BSD-3-Clause
"""A map is made of one survey, or of several that share a frame."""

from collections.abc import Sequence
from typing import cast

from magmatch.arguments import found
from magmatch.data.checks import require_one_frame, require_part, require_survey
from magmatch.data.survey import Survey
from magmatch.errors import SurveyError


def surveys_of(given: Survey | Sequence[Survey]) -> tuple[Survey, ...]:
    """Checked: each part and all together can be a survey."""
    if not isinstance(given, list | tuple):
        require_survey(given)
        return (cast("Survey", given),)
    if not given:
        msg = f"survey: expected a Survey or several, got {found(given)} without any; read_survey reads one"
        raise SurveyError(msg)
    for part in given:
        require_part(part)
    require_one_frame(given)
    require_survey(given[0].merged(*given[1:]))
    return tuple(given)
