# SPDX-License-Identifier: BSD-3-Clause
"""One figure of a survey, a map or a result for notebooks, and the pages of `magmatch view`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from magmatch.arguments import expect_kind
from magmatch.data.survey import Survey, has_order
from magmatch.field.map import FieldMap
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.viz.figures.draw import Figure
from magmatch.viz.figures.map_figures import field_figures
from magmatch.viz.figures.registration_figures import links_figure, scene_figures
from magmatch.viz.figures.slices import map_in
from magmatch.viz.figures.survey_figures import profile_figure, survey_figure
from magmatch.viz.pages import page
from magmatch.viz.pages.map_page import map_sections


def view(
    thing: Survey | FieldMap | RegistrationResult,
    base: Survey | FieldMap | None = None,
    target: Survey | FieldMap | None = None,
) -> Figure:
    """Draw a survey, a map, or a result with its surveys; a notebook displays the figure.

    Parameters
    ----------
    thing : Survey, FieldMap or RegistrationResult
    base, target : Survey or FieldMap, optional
        Of a result: drawn in the base's frame. Without them, only corresponding points are drawn.

    Returns
    -------
    plotly.graph_objects.Figure

    Raises
    ------
    MissingExtraError
        Needs Plotly, which the extra ``viz`` brings.
    """
    kinds: tuple[type[Any], ...] = (Survey, FieldMap)
    expect_kind(
        thing, "view", (*kinds, RegistrationResult), "read_survey, FieldMap.load and RegistrationResult.load read one"
    )
    if not isinstance(thing, RegistrationResult):
        field_map = map_in(thing)
        return survey_figure(survey_of(thing)) if field_map is None else field_figures(field_map)[0]
    if base is None and target is None:
        return links_figure(thing)
    expect_kind(base, "base", kinds, "view(result, base, target) takes both")
    expect_kind(target, "target", kinds, "view(result, base, target) takes both")
    assert base is not None
    assert target is not None
    return scene_figures(survey_of(base), survey_of(target), thing)[-1]


def write_view(path: str | Path, drawn: Sequence[Survey | FieldMap]) -> None:
    """Write one HTML page that shows surveys and maps, each in its own frame."""
    sections = []
    for item in drawn:
        field_map = map_in(item)
        sections += _of_survey(survey_of(item)) if field_map is None else _of_map(field_map)
    page.write_page(path, f"magmatch: {', '.join(survey_of(item).name for item in drawn)}", sections)


def _of_survey(survey: Survey) -> list[page.Section]:
    figures = [survey_figure(survey)]
    figures += [profile_figure(survey)] if has_order(survey) else []
    return [page.Section(f"Survey {survey.name}", [page.figure_row(figures)])]


def _of_map(field_map: FieldMap) -> list[page.Section]:
    """Its report, where several things are drawn each part with the map's name."""
    name = field_map.survey.name
    first, *rest = map_sections(field_map)
    return [replace(first, title=f"Map of {name}"), *(replace(s, title=f"{s.title}: {name}") for s in rest)]
