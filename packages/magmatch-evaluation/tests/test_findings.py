# SPDX-License-Identifier: BSD-3-Clause
"""Tables, pages and the parts of pages that others own."""

import math
import re
from dataclasses import replace

import pytest

import toy
from magmatch_evaluation.experiments import EXPERIMENTS, QUICK, Tolerance
from magmatch_evaluation.findings import Findings, markdown, result_tables, save_tables, write_html
from magmatch_evaluation.notes import PRINTED, PUBLISHED
from magmatch_evaluation.plan import ALL
from magmatch_evaluation.result_tables import mapping_table, printed_table
from magmatch_evaluation.rows import MapRow, Row
from magmatch_evaluation.statistics import shortfalls, summaries, summarize


def row(experiment, method, seed, distance=0.002, angle=0.001, *, is_accepted=True, is_there=True):
    status = "accepted" if is_accepted else "inconsistent"
    return Row(
        experiment, method, seed, "d", status, "", is_accepted, is_there, distance, angle, 0.9, 10, 10, 1.5, 2**20
    )


@pytest.fixture
def findings():
    """Made-up rows of every experiment and method; the second seed of `paper` finds nothing."""
    experiments = tuple(EXPERIMENTS.values())
    rows = [
        row(e.name, m, seed, math.inf if m == "paper" and seed else 0.001 * (k + 1), is_there=e.group != "refusals",
            is_accepted=e.group != "refusals" and not (m == "paper" and seed))
        for e in experiments if e.group != "mapping" for k, m in enumerate(e.methods) for seed in range(2)
    ]  # fmt: skip
    rows += [
        MapRow("map-room", "spline", 0, "d", "", 1e-6, 2e-6, 0.95, 1.0),
        MapRow("map-room", "idw", 0, "d", "", 3e-6, math.nan, math.nan, 1.0),
    ]
    left_out = {"experiment cea-floor1": "not here"}
    return Findings(experiments, rows, left_out, "magmatch evaluate")


def test_every_experiment_asks_methods_that_exist():
    for experiment in (*EXPERIMENTS.values(), *QUICK.values()):
        assert set(experiment.methods) <= set(ALL), experiment.name
    assert {(e, m) for e, m in PUBLISHED} <= {(e.name, m) for e in EXPERIMENTS.values() for m in e.methods}
    assert all(method.name == name for name, method in ALL.items())


def test_settings_of_experiments_and_methods_are_in_their_fingerprints():
    # A default repr with an address would make every run a new one.
    for thing in (*(e.make for e in EXPERIMENTS.values()), *ALL.values()):
        assert " at 0x" not in repr(thing), thing


def test_published_figures_stand_below_ours(findings):
    table = result_tables(findings)[0]
    k = next(k for k, cells in enumerate(table.rows) if cells[:2] == ("office-z30", "paper"))
    assert table.rows[k + 1][7:9] == ("81.6 ± 29.9", "3.23 ± 1.83")


def test_the_published_table_is_whole_and_says_what_differs(findings):
    table = printed_table(findings.of("published")[1])
    assert {cells[1] for cells in table.rows} == {e.name for e in EXPERIMENTS.values() if e.group == "published"}
    assert {cells[0] for cells in table.rows} == {row.title for row in PRINTED}
    assert all(len(cells) == len(table.header) and cells[-1] for cells in table.rows)
    cells = dict(zip(table.header, next(c for c in table.rows if c[1] == "noise-x30"), strict=True))
    assert cells["Mag-Match, as published"] == "19.4 ± 3.6, 0.92 ± 0.40"
    assert cells["paper"].endswith("of 1 only; 1 of 2 right (9% to 91%), 0 wrong, 0 refused, 1 no pose")
    assert table.title in markdown(findings)


def test_a_quick_run_stands_beside_the_published_table_too():
    table = printed_table(summaries(tuple(QUICK.values()), [row("quick-office-x30", "paper", 0)]))
    assert [(cells[1], cells[-1].endswith("fewer samples")) for cells in table.rows] == [("quick-office-x30", True)]


def test_trials_without_a_pose_are_told_and_have_no_95_percent(findings):
    cells = next(c for c in result_tables(findings)[0].rows if c[:2] == ("office-z30", "paper"))
    assert cells[2] == "1 of 2"
    assert cells[4:7] == ("0", "0", "1")
    assert all(cell.endswith(", of 1 only") for cell in cells[7:9])
    assert cells[10].startswith("none")


def test_outcomes_of_a_row_are_all_its_trials_and_all_lines_have_as_many_cells(findings):
    for table in result_tables(findings):
        assert {len(cells) for cells in table.rows} == {len(table.header)}, table.title
    table = result_tables(findings)[0]
    assert table.header[2:7] == ("right", "95 % interval", "wrong", "refused", "no pose")
    for cells in table.rows:
        if not cells[1].endswith("as published"):
            right, n = map(int, cells[2].split(" of "))
            assert right + sum(map(int, cells[4:7])) == n


def test_page_says_what_was_typed_and_left_out_and_how_much_of_the_run_is_in_it(findings):
    text, n = markdown(findings), len(findings.rows)
    assert text.startswith("`magmatch evaluate`")
    assert "Left out: experiment cea-floor1: not here." in text
    assert "Not the whole run" not in text
    assert f"Not the whole run: {n} of {n + 5} trials." in markdown(replace(findings, n_planned=n + 5))


def test_costs_do_not_touch_the_tables_of_results(findings):
    dearer = [replace(r, seconds=99.0, peak_bytes=2**30) if isinstance(r, Row) else r for r in findings.rows]
    other = replace(findings, rows=dearer)
    assert result_tables(findings) == result_tables(other)
    assert markdown(findings) != markdown(other)


def test_each_table_is_saved_under_the_name_of_its_group(findings):
    saved = {}

    def keeper(name):
        return lambda columns, rows, command: saved.update({name: (columns, rows, command)})

    save_tables(findings, {name: keeper(name) for name in (*findings.groups, "costs", "behind")})
    for group, table in zip(findings.groups, result_tables(findings), strict=True):
        assert saved[group] == (table.header, table.rows, "magmatch evaluate")
    assert saved["costs"][0][0] == "experiment"
    assert all(len(row) == 2 for row in saved["behind"][1])


def test_html_page_is_one_file_with_all_tables_and_a_figure_for_each_condition(findings, tmp_path):
    pytest.importorskip("plotly", reason="figures need the extra 'viz'")
    write_html(tmp_path / "report.html", findings)
    text = (tmp_path / "report.html").read_text()
    assert text.count('class="plot"') == len(findings.of("published")[0]) + 2 * 8
    assert all(title in text for title in ("Public recordings", "Harder: overlap", "Maps against held-out data"))
    assert not re.search(r"(src|href)=.https?:", text.split('id="plotly"')[0])


def test_page_of_one_experiment_can_be_written(tmp_path):
    pytest.importorskip("plotly", reason="figures need the extra 'viz'")
    plan = toy.toy_plan()
    write_html(tmp_path / "report.html", toy.toy_findings(plan, [row("toy", "one", 0)]))
    assert "toy" in (tmp_path / "report.html").read_text()


def summary(*distances, n_false=0):
    rows = [row("e", "m", k, d, is_accepted=math.isfinite(d)) for k, d in enumerate(distances)]
    rows += [row("e", "m", 100 + k, 9.0) for k in range(n_false)]
    return summarize(rows, Tolerance())


def test_where_another_is_better_it_is_said():
    ours, more, finer = summary(0.01, 0.01, math.inf), summary(0.05, 0.05, 0.05), summary(0.001, 0.001, math.inf)
    found = {("e", "default"): ours, ("e", "sift"): more, ("e", "paper"): finer, ("e", "gicp"): more}
    assert shortfalls(found) == [
        "e: sift was right in 3 of 3, default in 2 of 3.",
        "e: paper had a median error of 1.0 mm, default 10.0 mm.",
    ]
    # Where ours is ahead, nothing.
    assert shortfalls({("e", "default"): summary(0.001, 0.001), ("e", "paper"): summary(0.01, math.inf)}) == []


def test_mapping_table_shows_field_gradient_and_coverage_and_failures(findings):
    broken = MapRow("map-room", "harmonic", 0, "d", "ValueError", math.nan, math.nan, math.nan, math.nan)
    rows = [row for row in findings.rows if isinstance(row, MapRow)]
    table = mapping_table("t", [*rows, broken], {"map-room": "a room"})
    assert dict(zip(table.header, table.rows[0], strict=True)) == {
        "case": "a room", "spline": "1.00 (2.00) 95%", "idw": "3.00", "harmonic": "failed",
    }  # fmt: skip
