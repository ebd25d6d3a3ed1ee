# SPDX-License-Identifier: BSD-3-Clause
"""Tables of results do not lie about their age."""

import shutil
import subprocess
import sys
from argparse import ArgumentTypeError
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from unittest.mock import patch

import pytest
import write_results

from magmatch_evaluation.saved_table import ResultTable, saver, show
from magmatch_evaluation.script import kept

SOME = '{"columns": ["error"], "where": {"case": ["walk"]}}'
OLDER = "**Changed since: `src`.**"


def git(root, *words):
    name = ("-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "protocol.file.allow=always")
    return subprocess.run(["git", *name, *words], cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def commit(root):
    git(root, "add", "--all")
    git(root, "commit", "--quiet", "--allow-empty", "--message", "change")
    return git(root, "rev-parse", "HEAD")


def results(root, *options):
    """Exit code and all that is said."""
    said = StringIO()
    words = ["write_results.py", "--root", str(root), *options]
    with patch.object(sys, "argv", words), redirect_stdout(said), redirect_stderr(said):
        return write_results.main(), said.getvalue()


def table(commits, covers=("src",)):
    rows = [["room", "1.0"], ["walk", "2.0"]]
    return ResultTable(
        "Errors", "In mm.", "python b.py", commits, "m", "2026-01-02", covers, "One run.", ["case", "error"], rows
    )


def save(root, made, name="errors"):
    made.save(root / "benchmarks" / "results" / f"{name}.json")


@pytest.fixture
def root(tmp_path):
    """A repository whose only table is of its first commit, and whose pages are written."""
    for path, text in {
        "src/code.py": "x = 1\n",
        "src/.gitignore": "*.pyc\n",
        "other.txt": "a\n",
        "README.md": f"# R\n<!-- table: errors {SOME} -->\n<!-- end -->\n",
        "docs/results.md": "# Results\n\n<!-- table: errors -->\n<!-- end -->\n",
        "benchmarks/results/.keep": "",
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    git(tmp_path, "init", "--quiet")
    save(tmp_path, table([commit(tmp_path)]))
    assert results(tmp_path)[0] == 0
    commit(tmp_path)
    return tmp_path


def page(root):
    return (root / "docs" / "results.md").read_text()


def test_a_page_gets_tables_with_what_printed_them(root):
    commits = table([]).load(root / "benchmarks" / "results" / "errors.json").commits
    assert "| case | error |\n| --- | --- |\n| room | 1.0 |\n| walk | 2.0 |\n" in page(root)
    assert f"Errors: `python b.py`; commit {commits[0][:7]}, 2026-01-02." in page(root)
    assert "| error |\n| --- |\n| 2.0 |\n" in (root / "README.md").read_text()


@pytest.mark.parametrize(
    ("cell", "n", "shown"),
    [
        ("19 of 20 within 5 mm", 20, "19 of 20 (76-99 %) within 5 mm"),
        ("19 (95%), or refused: 1", 20, "19 of 20 (76-99 %), or refused: 1"),
        ("0", 812, "0 of 812 (0-0.5 %)"),
        ("1,196 of 1,200 within 5 mm", 1200, "1196 of 1200 (99-99.9 %) within 5 mm"),
        ("-", 20, "-"),
    ],
)
def test_counts_are_shown_with_what_they_are_of_and_the_interval_of_their_rate(cell, n, shown):
    assert write_results.with_interval(cell, n) == shown


def test_a_table_of_todays_code_passes_all_checks(root):
    before = page(root)
    assert OLDER not in before
    assert results(root, "--check")[0] == 0
    assert results(root, "--release")[0] == 0
    results(root)
    assert page(root) == before  # writing twice changes nothing


def test_a_page_that_was_edited_by_hand_fails(root):
    (root / "docs" / "results.md").write_text(page(root).replace("2.0", "0.2"))
    code, said = results(root, "--check")
    assert code == 1
    assert "docs/results.md: differs" in said


def test_words_about_covered_code_do_not_age_the_table(root):
    (root / "src" / "code.py").write_text('"""What x is."""\nx = 1  # m\n')
    assert results(root, "--release")[0] == 0


@pytest.mark.parametrize("path", ["src/code.py", "src/new.py"])
def test_a_change_of_covered_code_ages_the_table_before_and_after_its_commit(root, path):
    (root / path).write_text("x = 2\n")
    assert results(root, "--check")[0] == 1  # the page does not say so yet
    results(root)
    assert OLDER in page(root)
    commit(root)
    assert results(root, "--check") == (0, "1 tables\n")
    code, said = results(root, "--release")
    assert code == 1
    assert "errors: older than the code (src); run again: python b.py" in said


def test_code_that_was_found_to_answer_the_same_does_not_age_the_table_until_it_changes_again(root):
    first = git(root, "rev-parse", "HEAD")
    for text in ("x = 2 - 1\n", "x = 3 - 2\n"):
        (root / "src" / "code.py").write_text(text)
        last = commit(root)
        alike = replace(table([last], covers=["src"]), columns=["before", "after", "answers"])
        path = root / "benchmarks" / "results" / "same-answers.json"
        rows = ResultTable.load(path).rows if path.exists() else []
        save(root, replace(alike, rows=[*rows, [first, last, "120"]]), "same-answers")
        results(root)
        assert "Rewritten since, with the same answers to the bit: `src`." in page(root)
        assert results(root, "--release")[0] == 0
        first = last
    # Nor one of the last of them that is written back.
    save(root, table([last]))
    (root / "src" / "code.py").write_text("x = 2 - 1\n")
    results(root)
    assert results(root, "--release")[0] == 0
    (root / "src" / "code.py").write_text("x = 2\n")
    assert results(root, "--release")[0] == 1


def test_same_answers_say_nothing_of_code_that_did_not_answer(root):
    first = git(root, "rev-parse", "HEAD")
    (root / "src" / "code.py").write_text("x = 2\n")
    alike = table([commit(root)], covers=["src/other"])
    save(
        root,
        replace(alike, columns=["before", "after", "answers"], rows=[[first, *alike.commits, "9"]]),
        "same-answers",
    )
    assert results(root, "--release")[0] == 1


@pytest.mark.parametrize(("answers", "rc"), [("9 (other: meant to differ)", 0), ("8 (src: meant to differ)", 1)])
def test_answers_that_were_meant_to_differ_say_nothing_of_the_room_of_their_name(root, answers, rc):
    first = git(root, "rev-parse", "HEAD")
    (root / "src" / "code.py").write_text("x = 2 - 1\n")
    last = commit(root)
    alike = replace(table([last], covers=["src"]), columns=["before", "after", "answers"])
    save(root, replace(alike, rows=[[first, last, answers]]), "same-answers")
    results(root)
    assert results(root, "--release")[0] == rc


def test_of_several_commits_the_oldest_decides_and_what_a_table_covers_must_be_there(root):
    first = git(root, "rev-parse", "HEAD")
    (root / "src" / "code.py").write_text("x = 2\n")
    last = commit(root)
    save(root, table([first, last]))
    results(root)
    assert OLDER in page(root)
    save(root, table([last], covers=["scr"]))
    results(root)
    code, said = results(root, "--check")
    assert code == 1
    assert "errors: covers scr, which is not there" in said


def test_a_commit_outside_the_history_fails(root):
    git(root, "switch", "--quiet", "--create", "side")
    side = commit(root)
    git(root, "switch", "--quiet", "-")
    save(root, table([side]))
    results(root)
    code, said = results(root, "--check")
    assert code == 1
    assert f"errors: commit {side} is not in the history" in said


def test_an_unknown_commit_is_shown_as_such_and_counts_as_older(root):
    save(root, table([]))
    results(root)
    assert f"commit not recorded, 2026-01-02. {OLDER}" in page(root)
    assert results(root, "--check")[0] == 0
    assert results(root, "--release")[0] == 1


def test_a_place_without_a_table_fails_and_a_table_without_a_place_is_kept(root):
    (root / "benchmarks" / "results" / "errors.json").rename(root / "benchmarks" / "results" / "others.json")
    code, said = results(root, "--check")
    assert code == 1
    assert "others" not in said
    assert "README.md: no table errors" in said


@pytest.mark.parametrize("kind", ["archive in a repository", "shallow clone"])
def test_without_history_nothing_is_checked_and_it_says_so(root, tmp_path_factory, kind):
    place = tmp_path_factory.mktemp("place")
    if kind == "archive in a repository":
        git(place, "init", "--quiet")
    if kind == "shallow clone":
        git(place, "clone", "--quiet", "--depth", "1", root.as_uri(), "copy")
    else:
        shutil.copytree(root, place / "copy", ignore=shutil.ignore_patterns(".git"))
    code, said = results(place / "copy", "--check")
    assert code == 0
    assert "no history here" in said


def test_a_benchmark_saves_the_commit_it_began_with(root, monkeypatch):
    monkeypatch.chdir(root)
    monkeypatch.setattr("sys.argv", ["b.py", "--save", "errors", "--seed", "3", "--from", "/home/me/data"])
    begun = git(root, "rev-parse", "HEAD")
    keep = saver("errors")
    (root / "src" / "code.py").write_text("x = 2\n")
    commit(root)
    keep(["case", "error"], [["room", "0.5"]])
    found = ResultTable.load(root / "benchmarks" / "results" / "errors.json")
    assert found.commits == [begun]
    assert found.rows == [["room", "0.5"]]
    assert (found.title, found.note, found.remark, found.covers) == ("Errors", "In mm.", "", ["src"])
    assert found.command.endswith("python b.py --seed 3 --from DIR")


def test_kept_rows_keep_the_commits_they_were_made_of(root, monkeypatch):
    monkeypatch.chdir(root)
    monkeypatch.setattr("sys.argv", ["b.py", "--save", "errors"])
    for folder in ("packages/magmatch-evaluation/src", "benchmarks"):
        (root / folder / "code.py").parent.mkdir(parents=True, exist_ok=True)
        (root / folder / "code.py").write_text("x = 1\n")

    def rows(*names):
        return kept(root / "rows.jsonl", names, lambda name: {"name": name}).values()

    first = commit(root)
    rows("a")
    (root / "src" / "code.py").write_text("x = 2\n")
    second = commit(root)
    show(["case", "error"], [["room", "0.5"]], saver("errors"), rows("a", "b"))
    path = root / "benchmarks" / "results" / "errors.json"
    assert ResultTable.load(path).commits == sorted([first, second])
    (root / "benchmarks" / "code.py").write_text("x = 3\n")
    show(["case", "error"], [["room", "0.6"]], saver("errors"), rows("a", "c"))
    assert ResultTable.load(path).commits == []


def test_a_benchmark_of_uncommitted_code_saves_nothing(root, monkeypatch):
    monkeypatch.chdir(root)
    (root / "src" / "code.py").write_text("x = 2\n")
    with pytest.raises(ArgumentTypeError, match="commit first what has changed"):
        saver("errors")


def test_rows_that_do_not_fit_their_columns_are_refused(root):
    path = root / "benchmarks" / "results" / "errors.json"
    path.write_text(path.read_text().replace('["room", "1.0"]', '["room"]'))
    with pytest.raises(ValueError, match="expected 2 cells a row"):
        ResultTable.load(path)
