# SPDX-License-Identifier: BSD-3-Clause
"""One figure of a survey, a map or a result, for notebooks."""

from typing import TYPE_CHECKING, Any

from magmatch.arguments import expect_kind
from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.viz.figures.map_figures import field_figures
from magmatch.viz.figures.registration_figures import links_figure, scene_figures
from magmatch.viz.figures.survey_figures import survey_figure

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def view(
    thing: Survey | FieldMap | RegistrationResult,
    base: Survey | FieldMap | None = None,
    target: Survey | FieldMap | None = None,
) -> "Figure":
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
    if isinstance(thing, Survey):
        return survey_figure(thing)
    if isinstance(thing, FieldMap):
        return field_figures(thing)[0]
    if base is None and target is None:
        return links_figure(thing)
    expect_kind(base, "base", kinds, "view(result, base, target) takes both")
    expect_kind(target, "target", kinds, "view(result, base, target) takes both")
    assert base is not None
    assert target is not None
    return scene_figures(survey_of(base), survey_of(target), thing)[-1]
