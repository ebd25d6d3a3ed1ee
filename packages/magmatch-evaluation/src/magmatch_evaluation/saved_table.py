# SPDX-License-Identifier: BSD-3-Clause
"""A table of results in a file: its cells, the command that prints them, and their commit, machine and date."""

import json
import os
import platform
import re
import shlex
import subprocess
import sys
from argparse import ArgumentTypeError
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

FOLDER = Path("benchmarks") / "results"
PACKAGES = ("numpy", "scipy", "numba")


@dataclass(frozen=True, slots=True)
class ResultTable:
    """One table of the page of results."""

    title: str  # the note says what the cells mean; it holds no result
    note: str
    command: str  # prints the figures
    # What the code was when they were taken; several where rows are of several, none where it was not recorded
    commits: Sequence[str]
    machine: str
    date: str
    covers: Sequence[str]  # folders and files that the figures depend on, from the root of the repository
    remark: str  # about these figures alone; gone when they are taken anew
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    @classmethod
    def load(cls, path: Path) -> "ResultTable":
        """Read a table, and check that its rows fit its columns."""
        table = cls(**json.loads(path.read_text(encoding="utf-8")))
        if uneven := [row for row in table.rows if len(row) != len(table.columns)]:
            message = f"{path}: expected {len(table.columns)} cells a row, got {uneven[0]}"
            raise ValueError(message)
        return table

    def save(self, path: Path) -> None:
        """Write the table, one row a line, so that a change of one figure is a change of one line."""
        *entries, (_, rows) = asdict(self).items()
        lines = [f" {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}," for key, value in entries]
        cells = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
        path.write_text("\n".join(["{", *lines, ' "rows": [', cells, " ]", "}"]) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Saver:
    """What saves a table in its file, and the commit when the work began: others may commit in the hours it takes."""

    path: Path
    old: ResultTable
    commit: str

    def __call__(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        command: str | None = None,
        commits: Sequence[str] | None = None,
    ) -> None:
        """Save columns and rows, with the command if not as typed, and the commits if not that of the beginning."""
        commits = [self.commit] if commits is None else commits
        new = replace(self.old, remark="", command=command or typed(), commits=commits, machine=this_machine())
        replace(new, date=today(), columns=columns, rows=rows).save(self.path)


def saver(name: str) -> Saver:
    """Give what saves a benchmark's table: the type of its option ``--save NAME``.

    NAME is a file in ``benchmarks/results``, where title, note and covers stand already; `ArgumentTypeError` where
    it is not there, or where covered code is not committed.
    """
    path = FOLDER / f"{name}.json"
    try:
        old = ResultTable.load(path)
    except FileNotFoundError:
        message = f"expected {path}, with title, note and covers, below the current folder: docs/evaluation.md"
        raise ArgumentTypeError(message) from None
    return Saver(path, old, clean_commit(old.covers))


def show(
    columns: Sequence[str],
    rows: Sequence[Sequence[object]],
    save: Saver | None = None,
    made: Iterable[Mapping[str, Any]] | None = None,
) -> None:
    """Print a table as Markdown, and save it where that is asked for.

    ``made``: the rows of `script.kept` that it sums up, whose commits it then states.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    print(markdown_table(columns, cells), flush=True)  # noqa: T201
    if save is not None:
        save(columns, cells, commits=None if made is None else commits_of(made))


def commits_of(made: Iterable[Mapping[str, Any]]) -> list[str]:
    """Commits of kept rows; none, which counts as older than any code, where one is of code not committed."""
    commits = {row.get("commit") for row in made}
    return [] if None in commits else sorted(filter(None, commits))


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out cells for a Markdown page."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |" for cells in lines)


def clean_commit(covers: Sequence[str]) -> str:
    """Give the commit that is checked out; raise `ArgumentTypeError` where what is covered differs from it."""
    changed = git("status", "--porcelain", "--", *covers)
    if changed:
        message = f"figures are of a commit: commit first what has changed ({changed.split()[1]}, ...)"
        raise ArgumentTypeError(message)
    return git("rev-parse", "HEAD")


def git(*words: str) -> str:
    """Ask git about the current folder."""
    return subprocess.run(["git", *words], check=True, capture_output=True, text=True).stdout.strip()


def typed() -> str:
    """Give the command as it was typed, without the options that save, and with DIR for where files lie."""
    script, *rest = sys.argv
    words, kept = iter(rest), [Path(script).absolute().relative_to(Path.cwd()).as_posix()]
    for word in words:
        if word.startswith("--save"):
            next(words, None)
        else:
            kept.append(re.sub(r"[^=]*/.*", "DIR", word))
    threads = os.environ.get("OPENBLAS_NUM_THREADS")
    return (f"OPENBLAS_NUM_THREADS={threads} " if threads else "") + shlex.join(["python", *kept])


def this_machine(packages: Iterable[str] = PACKAGES) -> str:
    """Describe the machine, and the libraries that take the time."""
    installed = ", ".join(f"{name} {installed_version(name)}" for name in packages)
    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    return f"{machine}; Python {platform.python_version()}, {installed}"


def installed_version(package: str) -> str:
    """Version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def today() -> str:
    """Date as it is written in a table."""
    return date.today().isoformat()
