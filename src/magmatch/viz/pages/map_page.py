# SPDX-License-Identifier: BSD-3-Clause
"""The report of a map: its surveys, the field, its uncertainty, and how to reproduce it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from magmatch._version import __version__
from magmatch.data.survey import Survey, has_order
from magmatch.data.units import field_text
from magmatch.field.map import FieldMap
from magmatch.number_text import told
from magmatch.viz.figures.map_figures import (
    Coverage,
    cover_and_spread,
    field_figures,
    left_out,
    spread_figure,
)
from magmatch.viz.figures.slices import cut_through
from magmatch.viz.figures.survey_figures import profile_figure, survey_figure
from magmatch.viz.pages import page

# Most left-out samples listed one by one.
MAX_LISTED = 12
# What the numbers of a prior mean to a reader.
MEANINGS = {
    "lengthscale": "distance over which the field changes",
    "signal_sd": "how much a component of the field varies, by the prior",
    "noise_sd": "sensor noise and what the model cannot represent",
    "spacing": "spacing of the basis nodes",
    "stiffness": "weight of div B = 0 (0: not imposed, or exact)",
    "looseness": "standard deviation of the prior relative to signal_sd",
    "inflation": "factor on standard deviations, from the error on held-out data",
    "reach": "how far the map extends beyond samples, in spacings",
}


def write_map_report(path: str | Path, field_map: FieldMap, read: Sequence[Survey], command: str) -> None:
    """Write one HTML page about a map; it works offline and on a phone.

    `read` holds the surveys as read (map frame), to show which samples were left out; `command` reproduces the map.
    """
    sections = [*map_sections(field_map, read), _again(field_map, command)]
    page.write_page(path, f"magmatch: map of {field_map.survey.name}", sections)


def map_sections(field_map: FieldMap, read: Sequence[Survey] = ()) -> list[page.Section]:
    """Sections about a map, without how to reproduce it."""
    cut = cut_through(field_map.survey.positions)
    coverage, sd = cover_and_spread(field_map, cut.points)
    out = [survey.subset(left_out(field_map, survey)) for survey in read]
    main, *others = field_figures(field_map)
    return [
        page.Section("", [page.paragraph(_coverage_words(coverage))]),
        page.Section(
            "The field", [page.figure_row([main, spread_figure(field_map, cut, sd)]), page.figure_row(others)]
        ),
        _samples(field_map, out),
        page.Section(
            "Coverage", [page.columns([page.table(_facts(field_map))], [page.table(_coverage_rows(coverage))])]
        ),
        _prior(field_map),
    ]


def _facts(field_map: FieldMap) -> list[list[str]]:
    survey = field_map.survey
    extent = " by ".join(f"{side:.3g}" for side in np.ptp(survey.positions, axis=0))
    rows = [["Samples", str(len(survey))], ["Extent", f"{extent} m, frame '{survey.frame}'"]]
    if len(field_map.surveys) > 1:
        rows.append(["Surveys", ", ".join(f"{part.name} ({len(part)})" for part in field_map.surveys)])
    if field_map.biases is not None:
        rows.append(["Sensors", field_map.biases.in_words])
    rows += [["Prior", field_map.config.prior]]
    if field_map.config.domain is not None:
        rows.append(["Declared box", ", ".join(told(v) for v in field_map.config.domain) + " m"])
    return rows


def _coverage_rows(coverage: Coverage) -> list[list[str]]:
    rows = [
        ["Known", f"{coverage.known_share:.0%} of the box around the samples"],
        ["Field varies by", f"{field_text(coverage.variation)} (one component, over the samples)"],
    ]
    median, most = coverage.quantile(0.5), coverage.quantile(0.9)
    if median is not None and most is not None:
        rows.append(
            ["Standard deviation", f"{field_text(median)} in the median, {field_text(most)} for 90 % (known part)"]
        )
    return rows


def _coverage_words(coverage: Coverage) -> str:
    share = coverage.share_below(0.25 * coverage.variation)
    words = (
        f"The map knows {coverage.known_share:.0%} of the box around its samples. In {share:.0%} of that, the "
        "standard deviation is below a quarter of the field's variation, low enough to tell places apart."
    )
    return words + (" Survey the rest more densely." if share < 0.7 else "")


def _samples(field_map: FieldMap, out: Sequence[Survey]) -> page.Section:
    """Samples in space and along the way, and those that were left out."""
    n_out = sum(map(len, out))
    merged = out[0].merged(*out[1:]) if n_out else None
    figures = [survey_figure(field_map.survey, merged)]
    figures += [profile_figure(part) for part in field_map.surveys[:3] if has_order(part)]
    blocks = [page.figure_row(figures)]
    if out:
        words = (
            f"{n_out} samples contradict their neighbours (a ringing phone, passing metal?) and were not used; "
            "crosses mark them. The setting leave_out_outliers: false keeps them."
        )
        none = "No sample contradicts its neighbours; all were used."
        blocks += [page.subheading("Left out"), page.paragraph(words if n_out else none)]
    if merged is not None:
        said = field_map.evaluate(merged.positions).field
        apart = np.linalg.norm(merged.field - said, axis=1)
        worst = np.argsort(-apart, kind="stable")[:MAX_LISTED]
        columns: dict[str, Callable[[int], str]] = {
            "position (m)": lambda k: ", ".join(f"{v:.3f}" for v in merged.positions[k]),
            "|B| measured": lambda k: field_text(float(np.linalg.norm(merged.field[k]))),
            "|B| of the map": lambda k: field_text(float(np.linalg.norm(said[k]))),
            "difference": lambda k: field_text(float(apart[k])),
        }
        blocks.append(page.listing(worst, columns))
        if n_out > len(worst):
            blocks.append(page.note(f"The {len(worst)} of {n_out} that differ most."))
    return page.Section("Samples", blocks)


def _prior(field_map: FieldMap) -> page.Section:
    """Numbers of the prior, and how the priors compared where that was asked for."""
    numbers = field_map.hyperparameters.as_dict()
    rows = [[name, _number(name, value), MEANINGS.get(name, "")] for name, value in numbers.items()]
    blocks = [page.table(rows, ["", "value", "meaning"])]
    errors = field_map.config.comparison
    if errors:
        best, chosen = min(errors.values()), field_map.config.prior
        columns: dict[str, Callable[[str], str]] = {
            "prior": str,
            "typical error": lambda name: field_text(errors[name]),
            "relative to the best": lambda name: f"{100 * (errors[name] / best - 1):+.0f} %",
            "chosen": lambda name: "yes" if name == chosen else "",
        }
        compared = page.listing(sorted(errors, key=lambda name: errors[name]), columns)
        blocks += [
            page.subheading("Priors compared on held-out data"),
            compared,
            page.note("The spline is preferred unless another prior is clearly better: held-out errors are noisy."),
        ]
    else:
        blocks.append(page.note("Priors were not compared; 'magmatch map --prior auto' does."))
    return page.Section("Prior and hyperparameters", blocks)


def _number(name: str, value: float) -> str:
    if name.endswith("_sd"):
        return field_text(value)
    return f"{value:.3g}" + (" m" if name in ("lengthscale", "spacing") else "")


def _again(field_map: FieldMap, command: str) -> page.Section:
    words = (
        f"magmatch {__version__}. The same surveys and settings give the same map. Settings: save as settings.yaml."
    )
    settings = {"field": field_map.config.model_dump(mode="json", exclude={"comparison"})}
    return page.again("Reproduce this map", words, command, settings)
