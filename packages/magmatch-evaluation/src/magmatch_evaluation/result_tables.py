# SPDX-License-Identifier: BSD-3-Clause
"""Rows as text tables; Markdown and HTML lay out the same cells."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from magmatch_evaluation.experiments import QUICK_PREFIX, Experiment
from magmatch_evaluation.notes import PRINTED, PRINTED_NOTE, PUBLISHED, SOURCE, Figure
from magmatch_evaluation.rows import MapRow
from magmatch_evaluation.saved_table import markdown_table
from magmatch_evaluation.statistics import Spread, Summaries, Summary


@dataclass(frozen=True, slots=True)
class TextTable:
    """A title, a note, a header and cells of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def markdown(self) -> str:
        """Lay the table out for a Markdown page."""
        note = f"\n{self.note}\n" if self.note else ""
        return f"### {self.title}\n{note}\n{markdown_table(self.header, self.rows)}\n"


ERROR_HEADER = (
    "experiment", "method", "right", "95 % interval", "wrong", "refused", "no pose", "RMSE ± sd, mm",
    "RMSE ± sd, deg", "median, mm / deg", "95 %, mm / deg", "NEES",
)  # fmt: skip


def error_table(title: str, found: Summaries, floors: Mapping[str, str], note: str = "") -> TextTable:
    """Lay out success and errors, the published figures below ours where there are any.

    The accuracy of the data themselves, by experiment, has a column of its own where there is any.
    """
    has_floors, rows = any(floors.values()), []
    for (experiment, method), s in found.items():
        cells = [experiment, method, *_error_cells(s)]
        rows.append((*cells, floors.get(experiment, "")) if has_floors else tuple(cells))
        if p := PUBLISHED.get((experiment.removeprefix(QUICK_PREFIX), method)):
            rows.append((experiment, f"{method}, as published", "", "", "", "", "", *_printed_cells(p), "", "", ""))
    header = (*ERROR_HEADER, "accuracy of the data") if has_floors else ERROR_HEADER
    return TextTable(title, header, tuple(rows), note)


def printed_table(found: Summaries) -> TextTable:
    """Lay out the published table: its figures beside ours, and what differs in the data."""
    rows = []
    for printed in PRINTED:
        theirs = {m: ", ".join(_printed_cells(f)) for m, f in printed.figures.items()}
        for experiment, differs in printed.differs.items():
            for name, words in (
                (experiment, differs),
                (QUICK_PREFIX + experiment, f"{differs}; quick: fewer samples"),
            ):
                ours = {m: _outcome_cell(found[name, m]) for m in ("paper", "sift", "default") if (name, m) in found}
                if ours:
                    by_method = (
                        theirs.get("paper", "-"), ours.get("paper", "-"),
                        theirs.get("sift", "-"), ours.get("sift", "-"), ours.get("default", "-"),
                    )  # fmt: skip
                    rows.append((printed.title, name, *by_method, words))
    header = (
        "published experiment", "ours", "Mag-Match, as published", "paper", "SIFT, as published", "sift", "default",
        "what differs in the data",
    )  # fmt: skip
    return TextTable(
        "The published table, and ours beside it (mm, deg)", header, tuple(rows), f"{SOURCE}. {PRINTED_NOTE}"
    )


def _printed_cells(p: Figure) -> tuple[str, str]:
    """Errors of distance (mm) and angle (deg), as printed."""
    return f"{1e3 * p.distance:.1f} ± {1e3 * p.distance_sd:.1f}", f"{p.angle_deg:.2f} ± {p.angle_sd_deg:.2f}"


def _outcome_cell(s: Summary) -> str:
    """Errors and outcomes of all trials."""
    right, interval, wrong, refused, no_pose, *errors = _error_cells(s)[:7]
    return f"{', '.join(errors)}; {right} right ({interval}), {wrong} wrong, {refused} refused, {no_pose} no pose"


def curve_table(
    title: str, unit: str, experiments: Sequence[Experiment], found: Summaries, note: str = ""
) -> TextTable:
    """Lay out one condition, a value a row and a method a column: right answers, median error."""
    methods = [m for m in dict.fromkeys(m for e in experiments for m in e.methods) if any(k[1] == m for k in found)]
    rows = [
        (f"{e.value:g}", *(_curve_cell(found[e.name, m]) if (e.name, m) in found else "-" for m in methods))
        for e in experiments
    ]
    return TextTable(title, (unit, *methods), tuple(rows), note)


def _curve_cell(s: Summary) -> str:
    wrong = f", {s.n_false} wrongly" if s.n_false else ""
    return (
        f"{s.n_right} of {s.n}{wrong}; {_number(1e3 * s.distance.median, 1)} mm, {_number(s.angle_deg.median, 2)} deg"
    )


def refusal_table(title: str, found: Summaries, note: str = "") -> TextTable:
    """Lay out how often something was accepted where nothing is to be found."""
    rows = [
        (experiment, method, f"{s.n_false} of {s.n}", f"{1 - s.success[1]:.0%} to {1 - s.success[0]:.0%}",
         str(s.n_faults))
        for (experiment, method), s in found.items()
    ]  # fmt: skip
    return TextTable(title, ("experiment", "method", "accepted", "95 % interval", "broke down"), tuple(rows), note)


def cost_table(title: str, found: Summaries, note: str = "") -> TextTable:
    """Lay out time and memory, which differ from run to run."""
    rows = [
        (experiment, method, str(s.n), f"{s.seconds:.2f}", f"{s.peak_bytes / 2**20:.0f}")
        for (experiment, method), s in found.items()
    ]
    header = ("experiment", "method", "n", "median seconds (processor)", "peak memory, MiB")
    return TextTable(title, header, tuple(rows), note)


def mapping_table(title: str, rows: Sequence[MapRow], titles: Mapping[str, str], note: str = "") -> TextTable:
    """Lay out errors of priors and peers, a case a row: root mean square over the seeds in uT (gradient in uT/m).

    A cell says "failed" where a seed has no figure; the cases stand in the order of their titles.
    """
    methods = tuple(dict.fromkeys(row.method for row in sorted(rows, key=lambda r: math.isnan(r.coverage))))
    lines = []
    for case in titles:
        cells = [[row for row in rows if (row.experiment, row.method) == (case, method)] for method in methods]
        if any(cells):
            lines.append((titles[case], *map(_mapping_cell, cells)))
    return TextTable(title, ("case", *methods), tuple(lines), note)


def _mapping_cell(rows: Sequence[MapRow]) -> str:
    if not rows:
        return "-"
    if any(math.isnan(row.field_rmse) for row in rows):
        return "failed"
    field, gradient = (
        1e6 * math.sqrt(sum(getattr(row, name) ** 2 for row in rows) / len(rows))
        for name in ("field_rmse", "gradient_rmse")
    )
    coverage = sum(row.coverage for row in rows) / len(rows)
    inner = "" if math.isnan(gradient) else f" ({gradient:.2f})"
    return f"{field:.2f}{inner}" + ("" if math.isnan(coverage) else f" {coverage:.0%}")


def _error_cells(s: Summary) -> tuple[str, ...]:
    low, high = s.success
    # A root mean square of those that have a pose is not one of the trials.
    lacking = "" if s.n_posed == s.n else f", of {s.n_posed} only"
    return (
        f"{s.n_right} of {s.n}",
        f"{low:.0%} to {high:.0%}",
        str(s.n_false),
        str(s.n_posed - s.n_right - s.n_false),
        str(s.n - s.n_posed),
        *(
            (_rmse(s.distance, 1e3, 1) + lacking, _rmse(s.angle_deg, 1.0, 2) + lacking)
            if s.n_posed
            else ("none", "none")
        ),
        f"{_number(1e3 * s.distance.median, 1)} / {_number(s.angle_deg.median, 2)}",
        f"{_number(1e3 * s.distance.p95, 1)} / {_number(s.angle_deg.p95, 2)}",
        _number(s.nees, 2),
    )


def _rmse(spread: Spread, unit: float, digits: int) -> str:
    if not math.isfinite(spread.rmse):
        return "none"
    return f"{_number(unit * spread.rmse, digits)} ± {_number(unit * spread.sd, digits)}"


def _number(value: float, digits: int) -> str:
    """Text of a number; what is missing stays visibly so."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "none"
    return f"{value:.{digits}f}" if value < 1000 else f"{value:.0f}"
