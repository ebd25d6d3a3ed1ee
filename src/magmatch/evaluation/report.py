# SPDX-License-Identifier: BSD-3-Clause
"""The report of an evaluation: tables as Markdown, one HTML page with figures, and parts of pages that others own."""

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from magmatch._version import __version__
from magmatch.atomic import atomic_write
from magmatch.errors import DataFormatError
from magmatch.evaluation.comparison import shortfalls
from magmatch.evaluation.experiment import Experiment
from magmatch.evaluation.experiments import SWEEP_AXES, SWEEP_WORDS
from magmatch.evaluation.figures import curve_figures, error_figure
from magmatch.evaluation.notes import GROUP_NOTES, GROUP_TITLES, HOW_TO_READ, REASONS
from magmatch.evaluation.rows import MapRow, Row
from magmatch.evaluation.statistics import Summary
from magmatch.evaluation.tables import (
    TextTable,
    cost_table,
    curve_table,
    error_table,
    mapping_table,
    refusal_table,
    summaries,
)  # fmt: skip
from magmatch.viz.page import Section, bullets, figure_row, note, paragraph, table, to_copy, write_page

SECTION, SHORT = "evaluation", "evaluation table"
SHORT_METHODS = ("default", "paper", "sift", "sift-best")


@dataclass(frozen=True, eq=False, slots=True)
class Findings:
    """All that a run found.

    Attributes
    ----------
    experiments : tuple of Experiment
    rows : sequence of Row
    map_rows : sequence of MapRow
    case_titles : dict of str to str
        Words for the cases of the mapping table.
    left_out : dict of str to str
    command : str
    n_planned : int
        Trials of the whole run, mapping included; fewer rows were not run yet.
    """

    experiments: tuple[Experiment, ...]
    rows: Sequence[Row]
    map_rows: Sequence[MapRow]
    case_titles: Mapping[str, str]
    left_out: Mapping[str, str]
    command: str
    n_planned: int = 0

    def of(self, group: str) -> tuple[list[Experiment], Mapping[tuple[str, str], Summary]]:
        """Experiments of a group and their summaries."""
        experiments = [e for e in self.experiments if e.group == group]
        return experiments, summaries(experiments, self.rows)

    @property
    def groups(self) -> list[str]:
        """Groups that have experiments, in order."""
        return list(dict.fromkeys(e.group for e in self.experiments))


def group_table(findings: Findings, group: str) -> TextTable:
    """Lay out one group of experiments."""
    experiments, found = findings.of(group)
    title, words = GROUP_TITLES.get(group, group.capitalize()), GROUP_NOTES.get(group, "")
    if group in SWEEP_AXES:
        return curve_table(title, SWEEP_AXES[group], experiments, found, SWEEP_WORDS[group])
    if group == "refusals":
        return refusal_table(title, found, words)
    return error_table(title, found, {e.name: e.floor for e in experiments}, words)


def result_tables(findings: Findings) -> list[TextTable]:
    """Lay out all tables whose cells do not change when the run is repeated."""
    tables = [group_table(findings, group) for group in findings.groups]
    if findings.map_rows:
        words = GROUP_NOTES["mapping"]
        tables.append(mapping_table(GROUP_TITLES["mapping"], findings.map_rows, findings.case_titles, words))
    return tables


def markdown(findings: Findings) -> str:
    """Lay out the whole evaluation as Markdown, headings of the third level."""
    costs = cost_table("Time and memory", summaries(_main(findings), findings.rows), GROUP_NOTES["costs"])
    behind = _shortfalls(findings)
    listed = "\n".join(f"- {line}" for line in behind) if behind else "Nowhere in this run."
    blocks = [provenance(findings), HOW_TO_READ, *(t.markdown().strip() for t in result_tables(findings)),
              costs.markdown().strip(), f"### Where `default` is not ahead\n\n{listed}"]  # fmt: skip
    return "\n\n".join(blocks) + "\n"


def short_markdown(findings: Findings) -> str:
    """Lay out the published experiments for a first page."""
    experiments, found = findings.of("published")
    kept = {key: s for key, s in found.items() if key[1] in SHORT_METHODS}
    whole = error_table("", kept)
    columns = [whole.header.index(name) for name in ("experiment", "method", "right", "RMSE ± sd, mm",
                                                     "RMSE ± sd, deg", "median, mm / deg")]  # fmt: skip
    rows = tuple(tuple(row[k] for k in columns) for row in whole.rows)
    names = "; ".join(f"`{e.name}`: {e.title}" for e in experiments)
    text = TextTable("", tuple(whole.header[k] for k in columns), rows).markdown().partition("\n\n")[2]
    gaps = " ".join(_gaps(findings)[:1]) if findings.n_planned else ""
    return f"{text.strip()}\n\n{names}. `{findings.command}`, {date.today().isoformat()}. {gaps}".rstrip() + "\n"


def write_markdown(path: Path, findings: Findings) -> None:
    """Write the whole evaluation as a page of Markdown.

    Parameters
    ----------
    path : Path
    findings : Findings
    """
    with atomic_write(path) as stream:
        stream.write(markdown(findings).encode())


def write_html(path: Path, findings: Findings) -> None:
    """Write one self-contained page with all tables and figures.

    Parameters
    ----------
    path : Path
    findings : Findings

    Raises
    ------
    MissingExtraError
        Plotly is not installed.
    """
    behind = _shortfalls(findings)
    sections = [Section("", [paragraph(HOW_TO_READ)])]
    for group in findings.groups:
        experiments, found = findings.of(group)
        laid = group_table(findings, group)
        blocks = [paragraph(laid.note)] if laid.note else []
        if group in SWEEP_AXES and len(experiments) > 1:
            blocks.append(figure_row(curve_figures(group, SWEEP_AXES[group], experiments, found)))
        elif group == "published":
            blocks.append(figure_row([error_figure(e, findings.rows) for e in experiments]))
        sections.append(Section(laid.title, [*blocks, table(laid.rows, laid.header)]))
    if findings.map_rows:
        laid = result_tables(findings)[-1]
        sections.append(Section(laid.title, [paragraph(laid.note), table(laid.rows, laid.header)]))
    costs = cost_table("Time and memory", summaries(_main(findings), findings.rows), GROUP_NOTES["costs"])
    sections += [
        Section(costs.title, [paragraph(costs.note), table(costs.rows, costs.header)]),
        Section("Where default is not ahead", [bullets(behind) if behind else paragraph("Nowhere in this run.")]),
        Section("Run it again", [to_copy("command", findings.command), note(_versions()), bullets(_gaps(findings))]),
    ]
    write_page(path, "magmatch: evaluation", sections)


def provenance(findings: Findings) -> str:
    """Say what gave the figures: command, versions, machine, date, and what was left out."""
    return "\n".join([f"`{findings.command}`. {_versions()}", *_gaps(findings)])


def replace_between_marks(path: Path, findings: Findings) -> None:
    """Put results between the marks of a page: the whole section, or the short table, whichever it has marks for.

    Parameters
    ----------
    path : Path
        A page with the lines ``<!-- evaluation: begin -->`` and ``<!-- evaluation: end -->``, or the same with
        ``evaluation table``, or both.
    findings : Findings

    Raises
    ------
    DataFormatError
        The page has no such marks.
    """
    text, n_found = path.read_text(encoding="utf-8"), 0
    for name, content in ((SECTION, markdown), (SHORT, short_markdown)):
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, opened, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if opened and closed:
            text, n_found = f"{before}{begin}\n{content(findings).strip()}\n{end}{after}", n_found + 1
    if not n_found:
        raise DataFormatError(path, f"expected the lines '<!-- {SECTION}: begin -->' and '<!-- {SECTION}: end -->'")
    with atomic_write(path) as stream:
        stream.write(text.encode())


def _main(findings: Findings) -> list[Experiment]:
    """Experiments whose cost is worth a row: those of a curve differ little."""
    return [e for e in findings.experiments if e.group not in SWEEP_AXES]


def _shortfalls(findings: Findings) -> list[str]:
    experiments = [e for e in findings.experiments if e.group != "refusals"]
    return shortfalls(summaries(experiments, findings.rows), REASONS)


def _gaps(findings: Findings) -> list[str]:
    """Say what is not in the tables: trials not run yet, and what could not be run here."""
    n_run = len(findings.rows) + len(findings.map_rows)
    unfinished = [f"Not the whole run: {n_run} of {findings.n_planned} trials."] if n_run < findings.n_planned else []
    return unfinished + [f"Left out: {what}: {why}." for what, why in findings.left_out.items()]


def _versions() -> str:
    """Versions, machine and date on one line."""
    packages = {"numpy": "numpy", "scipy": "scipy", "numba": "numba", "cv2": "opencv-python-headless",
                "small_gicp": "small-gicp", "kiss_matcher": "kiss-matcher"}  # fmt: skip
    there = ", ".join(f"{name} {_version(name)}" for module, name in packages.items() if find_spec(module))
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"magmatch {__version__}, {there}; {machine}; {date.today().isoformat()}."


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(unknown version)"
