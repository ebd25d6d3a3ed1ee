# SPDX-License-Identifier: BSD-3-Clause
"""Fill in the tables of README.md and docs/results.md from the files in benchmarks/results.

    python benchmarks/write_results.py              # writes both pages
    python benchmarks/write_results.py --check      # fails where a page differs, or a commit is not in the history
    python benchmarks/write_results.py --release    # fails also where a table is older than the code it covers

A page has ``<!-- table: NAME {"columns": [...], "where": {COLUMN: [CELLS]}, "counts": [...], "n": COLUMN} -->`` where
a table begins and ``<!-- end -->`` where it ends; columns and rows are all where none are chosen, and counts of n get
95 % intervals. A table is older than the code where what it covers differs from its commit by more than comments and
docstrings: in the folder, so that a page and the change that ages its tables can be one commit. Two commits of which
``experiments/same_answers.py`` found all answers alike count as one, for the code that it runs.
"""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from magmatch_evaluation.saved_table import FOLDER, ResultTable, markdown_table
from magmatch_evaluation.script import arguments
from magmatch_evaluation.statistics import wilson_interval

PAGES = (Path("README.md"), Path("docs") / "results.md")
MARK = re.compile(r"(<!-- table: ([\w-]+) ?(\{.*?\})? ?-->\n).*?(<!-- end -->)", re.DOTALL)
NOT_RECORDED = "not recorded"
ALIKE = "same-answers"
COUNT = re.compile(r"^([\d,]+)( of [\d,]+| \(\d+%\))?")  # at the beginning of a cell


@dataclass(frozen=True)
class History:
    """What git knows about the folder."""

    root: Path
    alike: ResultTable | None = None  # pairs of commits that answer the same to the bit, and the code that answers
    # What was compared: tables cover the same code
    _differs: dict[tuple[str, str, str | None], bool] = field(default_factory=dict)

    @classmethod
    def of(cls, root: Path) -> "History":
        """Give the history of a folder, with what was found alike in it."""
        path = root / FOLDER / f"{ALIKE}.json"
        return cls(root, ResultTable.load(path) if path.exists() else None)

    def git(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Ask git about the folder."""
        return subprocess.run(["git", "-C", str(self.root), *words], check=False, capture_output=True, text=True)

    def is_whole(self) -> bool:
        """Whether the folder is a clone of its own, with all its commits."""
        top = self.git("rev-parse", "--show-toplevel")
        is_own = top.returncode == 0 and Path(top.stdout.strip()).resolve() == self.root.resolve()
        return is_own and self.git("rev-parse", "--is-shallow-repository").stdout.strip() == "false"

    def has(self, commit: str) -> bool:
        """Whether the code of today comes from a commit."""
        return self.git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0

    def changed(self, table: ResultTable) -> list[str]:
        """What a table covers that differs from any of its commits; all of it where no commit is known."""

        def differs(path: str) -> bool:
            is_new = self.git("ls-files", "--others", "--exclude-standard", "--", path).stdout
            return bool(is_new) or any(
                all(self.code_differs(same, path) for same in self.same_answers(commit, path))
                for commit in table.commits
            )

        return [path for path in table.covers if not table.commits or differs(path)]

    def same_answers(self, commit: str, path: str) -> list[str]:
        """A commit, and all whose code at a path was found to answer the same, before or after it."""
        found = [commit]
        if self.alike is None or not any(Path(path).is_relative_to(code) for code in self.alike.covers):
            return found

        def is_known(end: str) -> bool:
            return any(not self.code_differs(one, path, end) for one in found)

        # Questions that were meant to differ stand beside the number of answers.
        room = re.compile(rf"\b{Path(path).name}\b")
        pairs = [(before, after) for before, after, said in self.alike.rows if not room.search(said)]
        while more := [end for pair in pairs if any(map(is_known, pair)) for end in pair if end not in found]:
            found += more
        return found

    def code_differs(self, commit: str, path: str, other: str | None = None) -> bool:
        """Whether a file, or one below a folder, differs from a commit by more than comments and docstrings.

        It is the file as it lies in the folder, or of another commit.
        """
        asked = commit, path, other
        if asked not in self._differs:
            self._differs[asked] = self._compare(*asked)
        return self._differs[asked]

    def _compare(self, commit: str, path: str, other: str | None) -> bool:
        commits = [commit] if other is None else [commit, other]
        found = self.git("diff", "--name-status", "--no-renames", *commits, "--", path)
        changes = [line.split("\t") for line in found.stdout.splitlines()]
        return found.returncode != 0 or any(
            status != "M"
            or not name.endswith(".py")
            or code_of(self.text(name, commit)) != code_of(self.text(name, other))
            for status, name in changes
        )

    def text(self, name: str, commit: str | None) -> str:
        """A file of a commit, or as it lies in the folder."""
        return self.git("show", f"{commit}:{name}").stdout if commit else (self.root / name).read_text("utf-8")


def code_of(source: str) -> str:
    """The statements of a Python file, without its comments and docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            del node.body[0]
    return ast.dump(tree)


def caption(table: ResultTable, history: History) -> str:
    """Say what printed a table, and of when it is."""
    commits = ", ".join(commit[:7] for commit in table.commits) or NOT_RECORDED
    changed = history.changed(table)
    rewritten = [path for path in replace(history, alike=None).changed(table) if path not in changed]
    age = f" Rewritten since, with the same answers to the bit: {names(rewritten)}." if rewritten else ""
    age += f" **Changed since: {names(changed)}.**" if changed else ""
    return f"`{table.command}`; commit {commits}, {table.date}.{age}"


def names(paths: list[str]) -> str:
    """Name the last parts of paths."""
    return ", ".join(f"`{Path(path).name}`" for path in paths)


def with_interval(cell: str, n: int) -> str:
    """Put the 95 % interval of its rate behind a count of n."""

    def counted(found: re.Match[str]) -> str:
        k = number(found.group(1))
        low, high = (percent(100 * end) for end in wilson_interval(k, n))
        return f"{k} of {n} ({low}-{high} %)"

    return COUNT.sub(counted, cell)


def number(words: str) -> int:
    """Read a count, whose thousands may be parted by commas."""
    return int(words.replace(",", ""))


def percent(value: float) -> str:
    """Write a percentage, with a decimal where it would else pass for none or all."""
    return f"{value:.1f}".removesuffix(".0") if round(value) in (0, 100) else f"{value:.0f}"


def laid_out(
    table: ResultTable, history: History, columns: list[str], where: dict[str, list[str]], counts: list[str], n: str
) -> str:
    """Lay out some columns and rows of a table; counts are of column n, or of what another cell of the row says."""
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    cells = []
    for row in rows:
        if not all(row[name] in some for name, some in where.items()):
            continue
        of = row.get(n) or next(iter(re.findall(r"\d of ([\d,]+)", " ".join(row.values()))), "0")
        shown = [with_interval(row[name], number(of)) if name in counts else row[name] for name in columns]
        cells.append([re.sub("^nan .*", "-", cell) for cell in shown])
    if not cells:
        message = f"no row of {table.title!r} is where {where}"
        raise ValueError(message)
    return f"{markdown_table(columns, cells)}\n\n{table.title}: {caption(table, history)}"


def filled(page: str, tables: dict[str, ResultTable], history: History) -> str:
    """Put tables between their marks."""

    def block(found: re.Match[str]) -> str:
        begin, name, options, end = found.groups()
        table = tables.get(name)
        if table is None:
            return found.group()
        chosen = {"columns": list(table.columns), "where": {}, "counts": [], "n": "n"} | json.loads(options or "{}")
        return f"{begin}{laid_out(table, history, **chosen)}\n{end}"

    return MARK.sub(block, page)


def faults(tables: dict[str, ResultTable], root: Path, history: History, *, is_release: bool) -> Iterator[str]:
    """Say what is wrong with tables, and which page asks for one that is not there."""
    shown = {page: [mark.group(2) for mark in MARK.finditer((root / page).read_text("utf-8"))] for page in PAGES}
    yield from (f"{page}: no table {name}" for page in PAGES for name in shown[page] if name not in tables)
    # What no page shows is kept as it was printed.
    published = {name for names in shown.values() for name in names}
    for name, table in tables.items():
        if name in published:
            yield from (
                f"{name}: covers {path}, which is not there" for path in table.covers if not (root / path).exists()
            )
        yield from (f"{name}: commit {c} is not in the history" for c in table.commits if not history.has(c))
        if is_release and name in published and (changed := history.changed(table)):
            yield f"{name}: older than the code ({', '.join(changed)}); run again: {table.command}"


def main() -> int:
    # Of another checkout, where a root is given.
    asked = arguments(__doc__, check=False, release=False, root=Path)
    root = asked.root or Path(__file__).parents[1]
    history = History.of(root)
    if not history.is_whole():
        print("results: no history here (an archive or a shallow clone), so the age of tables is not checked")
        return 0
    tables = {path.stem: ResultTable.load(path) for path in sorted((root / FOLDER).glob("*.json"))}
    wrong = list(faults(tables, root, history, is_release=asked.release))
    for page in PAGES:
        text = (root / page).read_text(encoding="utf-8")
        new = filled(text, tables, history)
        if new != text and (asked.check or asked.release):
            wrong.append(f"{page}: differs from {FOLDER}; run: make results")
        elif new != text:
            (root / page).write_text(new, encoding="utf-8")
    print("\n".join(wrong) or f"{len(tables)} tables", file=sys.stderr if wrong else sys.stdout)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
