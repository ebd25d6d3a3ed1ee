# SPDX-License-Identifier: BSD-3-Clause
"""Rows as text tables; Markdown and HTML lay out the same cells."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from magmatch.evaluation.experiment import Experiment
from magmatch.evaluation.published import PUBLISHED
from magmatch.evaluation.rows import Row
from magmatch.evaluation.statistics import Spread, Summary, summarize


@dataclass(frozen=True, slots=True)
class TextTable:
    """A title, a header and cells of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def markdown(self) -> str:
        """Lay the table out for a Markdown page."""
        lines = [self.header, tuple("---" for _ in self.header), *self.rows]
        body = "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
        return f"### {self.title}\n{self.note}\n\n{body}\n" if self.note else f"### {self.title}\n\n{body}\n"


ERROR_HEADER = (
    "experiment", "method", "right", "95 % interval", "RMSE ± sd, mm", "RMSE ± sd, deg",
    "median, mm / deg", "95 %, mm / deg", "wrongly accepted", "NEES",
)  # fmt: skip


def summaries(experiments: Sequence[Experiment], rows: Sequence[Row]) -> Mapping[tuple[str, str], Summary]:
    """Sum up rows by (experiment, method), in the order of the experiments and their methods."""
    grouped: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        grouped.setdefault((row.experiment, row.method), []).append(row)
    return {
        (e.name, method): summarize(grouped[e.name, method], e.tolerance)
        for e in experiments for method in e.methods if (e.name, method) in grouped
    }  # fmt: skip


def error_table(title: str, found: Mapping[tuple[str, str], Summary], note: str = "") -> TextTable:
    """Lay out success and errors, the published figures below ours where there are any.

    Parameters
    ----------
    title : str
    found : dict of (experiment, method) to Summary
    note : str

    Returns
    -------
    TextTable
    """
    rows = []
    for (experiment, method), s in found.items():
        rows.append((experiment, method, *_error_cells(s)))
        if (experiment, method) in PUBLISHED:
            p = PUBLISHED[experiment, method]
            rows.append((
                experiment, f"{method}, as published", "", "",
                f"{1e3 * p.distance:.1f} ± {1e3 * p.distance_sd:.1f}", f"{p.angle_deg:.2f} ± {p.angle_sd_deg:.2f}",
                "", "", "", "",
            ))  # fmt: skip
    return TextTable(title, ERROR_HEADER, tuple(rows), note)


def refusal_table(title: str, found: Mapping[tuple[str, str], Summary], note: str = "") -> TextTable:
    """Lay out how often nothing was accepted where nothing is to be found."""
    rows = [
        (experiment, method, f"{s.n_false} of {s.n}", f"{1 - s.success[1]:.0%} to {1 - s.success[0]:.0%}", _faults(s))
        for (experiment, method), s in found.items()
    ]
    return TextTable(title, ("experiment", "method", "accepted", "95 % interval", "broke down"), tuple(rows), note)


def cost_table(title: str, found: Mapping[tuple[str, str], Summary], note: str = "") -> TextTable:
    """Lay out time and memory, which differ from run to run."""
    rows = [
        (experiment, method, f"{s.seconds:.2f}", f"{s.peak_bytes / 2**20:.0f}")
        for (experiment, method), s in found.items()
    ]
    return TextTable(
        title, ("experiment", "method", "median seconds (processor)", "peak memory, MiB"), tuple(rows), note
    )


def _error_cells(s: Summary) -> tuple[str, ...]:
    low, high = s.success
    lacking = "" if s.n_posed == s.n else f" ({s.n - s.n_posed} without a pose)"
    return (
        f"{s.n_right} of {s.n}",
        f"{low:.0%} to {high:.0%}",
        _rmse(s.distance, 1e3, 1) + lacking,
        _rmse(s.angle_deg, 1.0, 2),
        f"{_number(1e3 * s.distance.median, 1)} / {_number(s.angle_deg.median, 2)}",
        f"{_number(1e3 * s.distance.p95, 1)} / {_number(s.angle_deg.p95, 2)}",
        str(s.n_false),
        _number(s.nees, 2),
    )


def _faults(s: Summary) -> str:
    return str(s.n_faults) if s.n_faults else ""


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
