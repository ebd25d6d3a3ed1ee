# SPDX-License-Identifier: BSD-3-Clause
"""Pages of `magmatch view`: surveys and maps."""

from collections.abc import Sequence
from pathlib import Path

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.viz.page import Section, figure_row, write_page
from magmatch.viz.survey_figures import map_figures, profile_figure, survey_figure


def write_view(path: str | Path, drawn: Sequence[Survey | FieldMap]) -> None:
    """Write one HTML page that shows surveys and maps, each in its own frame.

    Parameters
    ----------
    path : path
        Where; an existing file is replaced once the new one is complete.
    drawn : sequence of Survey or FieldMap

    Raises
    ------
    MissingExtraError
        Plotly is not installed.
    """
    sections, names = [], []
    for item in drawn:
        survey = item if isinstance(item, Survey) else item.survey
        figures = [survey_figure(survey), profile_figure(survey)] if isinstance(item, Survey) else map_figures(item)
        names.append(survey.name)
        kind = "Survey " if isinstance(item, Survey) else "Map of "
        sections.append(Section(kind + survey.name, [figure_row(figures)]))
    write_page(path, f"magmatch: {', '.join(names)}", sections)
