# SPDX-License-Identifier: BSD-3-Clause
"""What a run found, as Markdown, as one HTML page with figures, and as tables for the page of results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from magmatch import __version__
from magmatch.viz.pages.page import Section, bullets, figure_row, note, paragraph, table, to_copy, write_page
from magmatch_evaluation.experiments import MAPPING, SWEEP_AXES, SWEEP_WORDS, Experiment
from magmatch_evaluation.figures import curve_figures, error_figure
from magmatch_evaluation.notes import GROUP_NOTES, GROUP_TITLES, HOW_TO_READ
from magmatch_evaluation.result_tables import (
    TextTable,
    cost_table,
    curve_table,
    error_table,
    mapping_table,
    printed_table,
    refusal_table,
)
from magmatch_evaluation.rows import AnyRow, MapRow
from magmatch_evaluation.saved_table import Saver, this_machine, today
from magmatch_evaluation.statistics import Summaries, shortfalls, summaries

NOWHERE = "Nowhere in this run."
# Tables that are no group's.
COSTS, BEHIND = "costs", "behind"
PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "small-gicp", "kiss-matcher")


@dataclass(frozen=True, eq=False, slots=True)
class Findings:
    """All that a run found; where it has fewer rows than were planned, the others were not run yet."""

    experiments: tuple[Experiment, ...]
    rows: Sequence[AnyRow]
    left_out: Mapping[str, str]
    command: str
    n_planned: int = 0

    def of(self, group: str) -> tuple[list[Experiment], Summaries]:
        """Experiments of a group and their summaries."""
        experiments = [e for e in self.experiments if e.group == group]
        return experiments, summaries(experiments, self.rows)

    @property
    def groups(self) -> list[str]:
        """Groups that have rows, in the order of the experiments."""
        there = {row.experiment for row in self.rows}
        return list(dict.fromkeys(e.group for e in self.experiments if e.name in there))

    @property
    def shortfalls(self) -> list[str]:
        """Where another method did better, a line each."""
        experiments = [e for e in self.experiments if e.group != "refusals"]
        return shortfalls(summaries(experiments, self.rows))

    @property
    def gaps(self) -> list[str]:
        """What is not in the tables: trials not run yet, and what could not be run here."""
        n, n_all = len(self.rows), self.n_planned
        unfinished = [f"Not the whole run: {n} of {n_all} trials."] if n < n_all else []
        return unfinished + [f"Left out: {what}: {why}." for what, why in self.left_out.items()]


def group_table(findings: Findings, group: str) -> TextTable:
    """Lay out one group of experiments."""
    experiments, found = findings.of(group)
    title, words = GROUP_TITLES.get(group, group.capitalize()), GROUP_NOTES.get(group, "")
    if group in SWEEP_AXES:
        return curve_table(title, SWEEP_AXES[group], experiments, found, SWEEP_WORDS[group])
    if group == "refusals":
        return refusal_table(title, found, words)
    if group == MAPPING:
        rows = [row for row in findings.rows if isinstance(row, MapRow)]
        return mapping_table(title, rows, {e.name: e.title for e in experiments}, words)
    return error_table(title, found, {e.name: e.floor for e in experiments}, words)


def result_tables(findings: Findings) -> list[TextTable]:
    """Lay out all tables whose cells do not change when the run is repeated."""
    return [group_table(findings, group) for group in findings.groups]


def _beside_the_published(findings: Findings) -> list[TextTable]:
    """Lay out the published table with ours beside it, where any of its experiments was run."""
    laid = printed_table(findings.of("published")[1])
    return [laid] if laid.rows else []


def costs(findings: Findings) -> TextTable:
    """Lay out time and memory, but for the points of a curve, which differ little."""
    dear = [e for e in findings.experiments if e.group not in SWEEP_AXES]
    return cost_table("Time and memory", summaries(dear, findings.rows), GROUP_NOTES["costs"])


def markdown(findings: Findings) -> str:
    """Lay out the whole evaluation as Markdown, headings of the third level."""
    provenance = "\n".join([f"`{findings.command}`. {_versions()}", *findings.gaps])
    laid = [*_beside_the_published(findings), *result_tables(findings), costs(findings)]
    tables = [one.markdown().strip() for one in laid]
    behind = "\n".join(f"- {line}" for line in findings.shortfalls) or NOWHERE
    return "\n\n".join([provenance, HOW_TO_READ, *tables, f"### Where `default` is not ahead\n\n{behind}"]) + "\n"


def write_html(path: Path, findings: Findings) -> None:
    """Write one self-contained page with all tables and figures."""
    sections = [Section("", [paragraph(HOW_TO_READ)])]
    for laid in _beside_the_published(findings):
        sections.append(Section(laid.title, [paragraph(laid.note), table(laid.rows, laid.header)]))
    for group in findings.groups:
        experiments, found = findings.of(group)
        laid = group_table(findings, group)
        blocks = [paragraph(laid.note)] if laid.note else []
        if group in SWEEP_AXES and len(experiments) > 1:
            blocks.append(figure_row(curve_figures(group, SWEEP_AXES[group], experiments, found)))
        elif group == "published":
            blocks.append(figure_row([error_figure(e, findings.rows) for e in experiments]))
        sections.append(Section(laid.title, [*blocks, table(laid.rows, laid.header)]))
    dear = costs(findings)
    sections += [
        Section(dear.title, [paragraph(dear.note), table(dear.rows, dear.header)]),
        Section("Where default is not ahead", [bullets(findings.shortfalls or [NOWHERE])]),
        Section("Run it again", [to_copy("command", findings.command), note(_versions()), bullets(findings.gaps)]),
    ]
    write_page(path, "magmatch: evaluation", sections)


def save_tables(findings: Findings, savers: Mapping[str, Saver]) -> None:
    """Give each table to what saves it, by the name of its group."""
    laid = {group: group_table(findings, group) for group in findings.groups} | {COSTS: costs(findings)}
    for name, text in laid.items():
        savers[name](text.header, text.rows, findings.command)
    lines = [line.split(": ", 1) for line in findings.shortfalls]
    savers[BEHIND](("experiment", "where another method is ahead"), lines, findings.command)


def _versions() -> str:
    """Versions, machine and date on one line."""
    return f"magmatch {__version__}; {this_machine(PACKAGES)}; {today()}."
