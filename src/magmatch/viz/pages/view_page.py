# SPDX-License-Identifier: BSD-3-Clause
"""Pages of `magmatch view`: surveys and maps."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from magmatch.data.order import has_order
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.maps import survey_of
from magmatch.viz.figures.survey_figures import profile_figure, survey_figure
from magmatch.viz.pages.map_page import map_sections
from magmatch.viz.pages.page import Section, figure_row, write_page


def write_view(path: str | Path, drawn: Sequence[Survey | FieldMap]) -> None:
    """Write one HTML page that shows surveys and maps, each in its own frame."""
    sections = []
    for item in drawn:
        sections += _of_survey(item) if isinstance(item, Survey) else _of_map(item)
    write_page(path, f"magmatch: {', '.join(survey_of(item).name for item in drawn)}", sections)


def _of_survey(survey: Survey) -> list[Section]:
    figures = [survey_figure(survey)]
    figures += [profile_figure(survey)] if has_order(survey) else []
    return [Section(f"Survey {survey.name}", [figure_row(figures)])]


def _of_map(field_map: FieldMap) -> list[Section]:
    """Its report, where several things are drawn each part with the map's name."""
    name = field_map.survey.name
    first, *rest = map_sections(field_map)
    return [replace(first, title=f"Map of {name}"), *(replace(s, title=f"{s.title}: {name}") for s in rest)]
