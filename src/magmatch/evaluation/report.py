# SPDX-License-Identifier: BSD-3-Clause
"""The report of an evaluation: tables as Markdown, and between marks in pages that others own."""

import platform
from collections.abc import Sequence
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from magmatch import __version__
from magmatch.atomic import atomic_write
from magmatch.errors import DataFormatError
from magmatch.evaluation.plan import Plan
from magmatch.evaluation.published import SOURCE
from magmatch.evaluation.rows import Row
from magmatch.evaluation.tables import TextTable, cost_table, error_table, refusal_table, summaries

BEGIN, END = "<!-- evaluation: begin -->", "<!-- evaluation: end -->"
HOW_TO_READ = (
    "Right: accepted and within tolerance. Trials that failed count in every column: RMSE and standard deviation, as "
    "published, are of the best pose of every trial, accepted or not; median and 95 % take a trial without a pose as "
    "infinitely far off ('none'). NEES is per degree of freedom, 1 where the stated covariance is right. 'As "
    f"published': {SOURCE}; its data are not public, ours are equivalents."
)


def result_tables(plan: Plan, rows: Sequence[Row]) -> list[TextTable]:
    """Lay out all tables of a run whose cells do not change when it is run again."""
    tables = []
    for group in dict.fromkeys(e.group for e in plan.experiments):
        found = summaries([e for e in plan.experiments if e.group == group], rows)
        table = refusal_table if group == "refusals" else error_table
        tables.append(table(group.capitalize(), found))
    return tables


def write_markdown(path: Path, plan: Plan, rows: Sequence[Row], command: str) -> None:
    """Write all tables to a page of their own."""
    found = summaries(plan.experiments, rows)
    tables = [*result_tables(plan, rows), cost_table("Time and memory", found, "Maps included.")]
    text = "\n".join([f"{provenance(plan, command)}\n\n{HOW_TO_READ}\n", *(table.markdown() for table in tables)])
    with atomic_write(path) as stream:
        stream.write(text.encode())


def provenance(plan: Plan, command: str) -> str:
    """Say what gave the figures: command, versions, machine, date, and what was left out."""
    packages = ", ".join(f"{name} {_version(name)}" for name in ("numpy", "scipy", "numba"))
    machine = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    text = f"`{command}`; magmatch {__version__}, {packages}; {machine}; {date.today().isoformat()}."
    return text + "".join(f"\nLeft out: {what}: {why}." for what, why in plan.left_out.items())


def replace_between_marks(path: Path, content: str) -> None:
    """Put generated text between the marks of a page.

    Parameters
    ----------
    path : Path
        A page that holds the lines `BEGIN` and `END`, once each and in this order.
    content : str

    Raises
    ------
    DataFormatError
        The page has no such marks.
    """
    before, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise DataFormatError(path, f"expected the lines '{BEGIN}' and '{END}' to put the results between")
    with atomic_write(path) as stream:
        stream.write(f"{before}{BEGIN}\n{content.strip()}\n{END}{after}".encode())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(none)"
