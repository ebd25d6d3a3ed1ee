# SPDX-License-Identifier: BSD-3-Clause
"""What the benchmark scripts share."""

import sys
from pathlib import Path

import pytest

from magmatch_evaluation.script import alone, arguments, in_groups, kept


def length_of(name):
    return {"name": name, "length": len(name)}


def test_rows_that_are_there_are_not_made_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rows.jsonl"
    first = kept(path, ["a", "bb"], length_of)
    again = kept(path, ["bb", "ccc"], lambda name: {"name": name, "length": -1})
    of_no_commit = {"commit": None}
    assert first == {"a": length_of("a") | of_no_commit, "bb": length_of("bb") | of_no_commit}
    assert again == {"bb": length_of("bb") | of_no_commit, "ccc": {"name": "ccc", "length": -1} | of_no_commit}
    assert len(path.read_text().splitlines()) == 3
    # None is begun after the time.
    assert kept(path, ["dddd"], length_of, minutes=0.0) == {}


def test_rows_are_grouped_by_the_words_that_their_names_begin_with():
    rows = {name: {"name": name} for name in ("hall 1 7", "hall 11 7", "hall 1 8")}
    grouped = in_groups(["table 1", "hall 1", "hall 11"], rows)
    assert [(group, [row["name"] for row in some]) for group, some in grouped] == [
        ("hall 1", ["hall 1 7", "hall 1 8"]),
        ("hall 11", ["hall 11 7"]),
    ]


def test_options_follow_from_their_defaults(monkeypatch):
    words = ["script", "one", "--lengths", "5", "10", "--from", "there", "--is-fast", "--spacing", "0.5"]
    monkeypatch.setattr(sys, "argv", words)
    asked = arguments("", (), lengths=[20.0], recordings=None, is_fast=False, spacing=float, seeds=3)
    assert vars(asked) == {
        "words": ["one"], "lengths": [5.0, 10.0], "recordings": Path("there"), "is_fast": True, "spacing": 0.5,
        "seeds": 3,
    }  # fmt: skip


def test_script_in_a_process_of_its_own_returns_its_last_line_or_is_an_error(tmp_path, capsys):
    script = tmp_path / "script.py"
    script.write_text("import sys\nprint('words')\nprint(f'[{sys.argv[1]}]')\n")
    assert alone(str(script), 3) == [3]
    assert capsys.readouterr().out == "words\n"
    script.write_text("raise SystemExit(1)")
    with pytest.raises(Exception, match="non-zero exit status"):
        alone(str(script))


def test_rows_that_do_not_say_their_name_are_found_again(tmp_path):
    made = []

    def make(name):
        made.append(name)
        return {"value": 2.0}

    for names in (["a 1"], ["a 1", "a 2"]):
        rows = kept(tmp_path / "rows.jsonl", names, make)
    assert made == ["a 1", "a 2"]
    assert [rows[name]["value"] for name in ("a 1", "a 2")] == [2.0, 2.0]
