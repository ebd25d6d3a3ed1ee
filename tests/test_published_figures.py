# SPDX-License-Identifier: BSD-3-Clause
"""README's figures fail where one leaves its interval, and every published table is renewed by one command."""

from pathlib import Path

import headline
import numpy as np
import pytest
import renew_results as renewal
from write_results import MARK, PAGES

from magmatch_evaluation.saved_table import ResultTable

ROOT = Path(__file__).parents[1]


def stated(rows):
    return ResultTable("t", "", "c", [], "m", "2026-01-02", [], "", ["pairs"] * len(rows[0]), rows)


ROW = ["office", "default", "10 of 10 (72 to 100 %)", "0 of 10 (0 to 28 %)", "1.0 (0.8 to 1.3)", "-"]


def test_figures_within_their_intervals_pass():
    now = [*ROW[:2], "8 of 10 (49 to 94 %)", "2 of 10 (6 to 51 %)", "1.3 (0.9 to 1.5)", "-"]
    assert list(headline.outside([now], stated([ROW]))) == []


@pytest.mark.parametrize(
    ("column", "cell"),
    [
        (2, "7 of 10 (40 to 89 %)"),
        (3, "3 of 10 (11 to 60 %)"),
        (4, "1.4 (1.0 to 2.0)"),
        (4, "0.7 (0.5 to 0.9)"),
        (4, "-"),
        (5, "1.0 (0.8 to 1.3)"),
    ],
)
def test_a_figure_that_left_its_interval_is_named_with_both(column, cell):
    (said,) = headline.outside([[*ROW[:column], cell, *ROW[column + 1 :]]], stated([ROW]))
    assert f"{headline.COLUMNS[column]} is {cell}, README states {ROW[column]}" in said


@pytest.mark.parametrize("n", [6, 10, 25])
def test_order_statistics_enclose_a_median_as_often_as_is_said(n):
    rng = np.random.default_rng(n)
    ends = np.array([headline.enclosing(row)[1:] for row in rng.exponential(size=(500, n))])
    share = ((ends[:, 0] <= np.log(2)) & (np.log(2) <= ends[:, 1])).mean()
    # Five hundred draws: a percent.
    assert 0.925 < share < 0.995


def test_every_published_table_is_renewed():
    renewed = {name for run in renewal.RUNS for name in run.tables}
    pages = ((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    assert {mark.group(2) for page in pages for mark in MARK.finditer(page)} == renewed
    assert sum(run.minutes for run in renewal.RUNS) <= 240


def test_a_run_fills_in_where_things_lie_and_saves_each_of_its_tables():
    run = renewal.Run(("rooms", "pairs"), "e.py --out {out} --jobs {jobs} --from {data}", 1, "--save {0} --pairs {1}")
    words = run.command(2, Path("/my data"), Path("/out"))[1:]
    assert words == [
        "benchmarks/e.py", "--out", "/out/rooms", "--jobs", "2", "--from", "/my data", "--save", "rooms",
        "--pairs", "pairs",
    ]  # fmt: skip


def test_what_is_of_todays_code_or_lacks_its_recordings_is_not_run(monkeypatch, capsys):
    runs = [renewal.Run((name,), words, 1) for name, words in (("new", ""), ("old", ""), ("data", "{data}"))]
    monkeypatch.setattr(renewal, "is_of_today", lambda run, _: run.tables == ("new",))
    assert [run.tables for run in renewal.to_do(runs, None, None)] == [("old",)]
    assert "data: left out" in capsys.readouterr().out
