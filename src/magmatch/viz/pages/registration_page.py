# SPDX-License-Identifier: BSD-3-Clause
"""The report of a registration: the verdict in words, the pictures, and how to reproduce it."""

from pathlib import Path

from magmatch.data.survey import Survey, has_order
from magmatch.field.map import FieldMap
from magmatch.published.config import PublishedConfig
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.viz.figures.agreement_figures import LARGEST_ORDINARY, agreement_figures, along_figure, compare
from magmatch.viz.figures.published_figures import published_figures
from magmatch.viz.figures.registration_figures import (
    match_figure,
    scene_figures,
    shown_pose,
    slice_figures,
    time_figure,
)
from magmatch.viz.figures.slices import map_in
from magmatch.viz.pages import page
from magmatch.viz.pages.registration_tables import (
    answer_words,
    certainty,
    figures_table,
    free_directions,
    other_poses,
    reproduced,
    transform_table,
)
from magmatch.viz.verdict import MEANING, headline, next_steps


def write_report(
    path: str | Path,
    base: Survey | FieldMap | None,
    target: Survey | FieldMap | None,
    result: RegistrationResult,
    command: str | None = None,
    published: PublishedConfig | None = None,
) -> None:
    """Write one HTML page about a registration; it works offline and on a phone.

    Maps add slices and residuals; without base or target nothing is drawn. `command` reproduces the result, with
    the settings in ``settings.yaml``. Settings of the published method, if it was that, add what it saw in both maps.
    """
    sections = [_answer(result)]
    if base is not None and target is not None:
        base_survey, target_survey = survey_of(base), survey_of(target)
        sections.append(
            page.Section("In space", [page.figure_row(scene_figures(base_survey, target_survey, result))])
        )
        base_map, target_map = map_in(base), map_in(target)
        if base_map is not None and target_map is not None:
            sections += _field(base_map, target_map, result)
            if published is not None:
                figures = published_figures(base_map, target_map, result.links, published).values()
                sections.append(
                    page.Section("What the published method sees", [page.figure_row([one]) for one in figures])
                )
        sections += _agreement(base_map, target, result)
        sections += certainty(result, target_survey)
        sections += free_directions(result, base_survey, target_survey)
    else:
        sections += certainty(result, None)
    sections += other_poses(result, base, target)
    in_numbers, figure = [page.columns([transform_table(result)], [figures_table(result)])], time_figure(result)
    in_numbers += [] if figure is None else [page.details("Time per stage", page.figure_row([figure]))]
    sections.append(page.Section("In numbers", in_numbers))
    sections.append(reproduced(result, command))
    page.write_page(path, _title(result), sections)


def _title(result: RegistrationResult) -> str:
    names = [str(entry.get("name", "?")) for entry in result.inputs]
    return f"magmatch: {names[1]} in the frame of {names[0]}" if len(names) == 2 else "magmatch: registration"


def _answer(result: RegistrationResult) -> page.Section:
    """The verdict, what it means, and what to do next."""
    return page.Section(
        "",
        [
            page.verdict(headline(result), result.reason, answer_words(result), is_good=result.is_accepted),
            page.paragraph(MEANING[result.status]),
            page.details("What to do next", page.bullets(next_steps(result)), is_open=not result.is_accepted),
        ],
    )


def _field(base: FieldMap, target: FieldMap, result: RegistrationResult) -> list[page.Section]:
    """Both maps on one cut, and side by side with the links between them."""
    blocks = [
        page.note("One colour scale for both maps. Blank: the map has no samples nearby."),
        page.figure_row(slice_figures(base, target, result)),
    ]
    matches = match_figure(base, target, result)
    if matches is not None:
        blocks.append(page.details("Matching keypoints", page.figure_row([matches])))
    return [page.Section("The field of both maps", blocks)]


def _agreement(base: FieldMap | None, target: Survey | FieldMap, result: RegistrationResult) -> list[page.Section]:
    """Whether the base explains the target's samples, under the pose that is shown."""
    T_base_target = shown_pose(result)
    if T_base_target is None:
        return []
    title = "Overlap and residuals"
    if base is None:
        words = "This needs a map of the base. None could be made: too few samples, or settings of another version."
        return [page.Section(title, [page.note(words)])]
    compared = compare(base, target, T_base_target, result)
    n, n_all = len(compared.rows), len(survey_of(target))
    words = f"Based on {n} of the target's {n_all} samples, evenly chosen. " if n < n_all else ""
    if not result.is_accepted:
        words += "The pose is the best candidate, which was not accepted. "
    if compared.rms is None:
        words += "None of the samples lies where the base map knows the field."
    else:
        n_large, n_known = compared.is_large.sum(), compared.is_known.sum()
        words += (
            f"In the overlap the median residual is {compared.typical:.2f} times what noise and the uncertainty of "
            "the base map explain (the figure at the top is the registration's own, from its grid and samples). The "
            f"root mean square, in which single bad samples count in full, is {compared.rms:.2f}. {n_large} of "
            f"{n_known} samples exceed {LARGEST_ORDINARY:.1f}; 1 in 1000 would by chance."
        )
    blocks = [page.paragraph(words), page.figure_row(agreement_figures(base, compared))]
    if compared.rms is not None and has_order(survey_of(target)):
        blocks.append(page.figure_row([along_figure(compared)]))
    return [page.Section(title, blocks)]
