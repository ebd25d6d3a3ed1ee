# SPDX-License-Identifier: BSD-3-Clause
"""Runs: interrupted ones lose and repeat nothing, failures become rows, what cannot be run is said."""

import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace

import pytest

import toy
from magmatch.errors import ConfigurationError
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.benchmark import evaluate
from magmatch_evaluation.experiments import Experiment
from magmatch_evaluation.plan import chosen_experiments, chosen_methods, make_plan
from magmatch_evaluation.rows import Row, RowFile
from magmatch_evaluation.survey_pairs import Simulated


def without_costs(rows):
    return [replace(row, seconds=0.0, peak_bytes=0) for row in rows]


@pytest.mark.slow
def test_run_killed_again_and_again_repeats_nothing_and_gives_the_same_table(tmp_path):
    words = [sys.executable, toy.__file__, str(tmp_path)]
    n_killed = 0
    for _ in range(30):
        process = subprocess.Popen(words)
        rows = tmp_path / "rows.jsonl"
        before = rows.stat().st_size if rows.exists() else 0
        while process.poll() is None and (not rows.exists() or rows.stat().st_size < before + 3500):
            time.sleep(0.005)
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.wait()
        n_killed += 1
    assert process.returncode == 0
    assert n_killed >= 2
    plan = toy.toy_plan()
    undisturbed = evaluate(plan, tmp_path / "undisturbed")
    assert (tmp_path / "results.md").read_text() == toy.tables(plan, undisturbed)
    calls = Counter((tmp_path / "calls.txt").read_text().splitlines())
    # Only the batch in the middle of which a kill came is done again.
    assert sum(calls.values()) <= 40 + 2 * n_killed


def test_finished_run_is_not_run_again(tmp_path):
    calls = tmp_path / "calls.txt"
    plan = toy.toy_plan(str(calls))
    told = []
    first = evaluate(plan, tmp_path / "new", tell=told.append)
    again = evaluate(plan, tmp_path / "new")
    assert [repr(row) for row in first] == [repr(row) for row in again]
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"rows.jsonl", "rows.csv"}
    assert [(p.n_done, p.n_all) for p in told] == [(n, 40) for n in range(0, 41, 2)]
    assert (told[0].seconds_left, told[-1].seconds_left) == (None, 0)
    assert len(calls.read_text().splitlines()) == 40


def test_more_seeds_and_methods_go_on_from_what_is_there(tmp_path):
    calls = tmp_path / "calls.txt"
    methods = {name: toy.Spoilt(name, str(calls)) for name in ("one", "two")}
    evaluate(make_plan([toy.toy_experiment()], {"one": methods["one"]}, n_seeds=3), tmp_path)
    rows = evaluate(make_plan([toy.toy_experiment()], methods, n_seeds=5), tmp_path)
    assert len(rows) == 10
    assert Counter(calls.read_text().splitlines()).most_common(1)[0][1] == 1


def test_rows_of_other_settings_are_not_taken(tmp_path):
    evaluate(make_plan([toy.toy_experiment(n_samples=12)], {"one": toy.Spoilt("one")}, n_seeds=2), tmp_path)
    other = make_plan([toy.toy_experiment(n_samples=20)], {"one": toy.Spoilt("one")}, n_seeds=2)
    rows = evaluate(other, tmp_path)
    assert [row.n_base for row in rows] == [20, 20]
    assert len(RowFile(tmp_path / "rows.jsonl", Row).read()) == 4


def test_method_that_breaks_down_has_failed_and_the_others_go_on(tmp_path):
    methods = {"one": toy.Spoilt("one", faulty_seed=1001), "two": toy.Spoilt("two")}
    rows = evaluate(make_plan([toy.toy_experiment()], methods, n_seeds=3), tmp_path)
    fault = next(row for row in rows if row.status == "fault")
    assert (fault.method, fault.seed, fault.reason) == ("one", 1001, "ValueError: broke down")
    assert len(rows) == 6


def test_all_methods_of_a_seed_see_the_same_pair_and_a_start_as_rough_as_stated(tmp_path):
    rows = evaluate(toy.toy_plan(), tmp_path)
    errors = {}
    for row in rows:
        errors.setdefault((row.experiment, row.seed), set()).add((row.distance, row.angle))
    assert all(len(found) == 1 for found in errors.values())
    rows = [row for row in rows if row.is_accepted]
    assert [row.distance for row in rows] == pytest.approx([0.3] * len(rows))
    assert [row.angle for row in rows] == pytest.approx([0.17453292519943295] * len(rows))


@pytest.mark.slow
def test_workers_give_the_same_rows(tmp_path):
    pytest.importorskip("magpylib", reason="surveys are simulated with the extra 'simulation'")
    make = Simulated("uniform", SimulationConfig(n_samples=40))
    plan = make_plan([Experiment("u", "", "", make, 2, ("default",))], chosen_methods("default"))
    told = []
    there = evaluate(plan, tmp_path / "there", jobs=2, tell=told.append)
    here = evaluate(plan, tmp_path / "here")
    # A uniform field leaves the pose free, which magnifies the last bits of another process.
    assert [repr(row) for row in without_costs(there)] == [repr(row) for row in without_costs(here)]
    assert told[-1].n_done == told[-1].n_all == len(here)
    assert told[-1].seconds_left == 0


def test_what_cannot_be_run_is_left_out_and_said(tmp_path):
    missing = toy.Spoilt("two", module="no_such_module")
    experiments = [toy.toy_experiment(), toy.toy_experiment("recorded", dataset="cea")]
    plan = make_plan(experiments, {"one": toy.Spoilt("one"), "two": missing}, recordings=tmp_path)
    assert {batch.experiment.name for batch in plan.batches} == {"toy"}
    assert "no_such_module is not installed" in plan.left_out["method two"]
    assert "magmatch datasets fetch cea" in plan.left_out["experiment recorded"]


@pytest.mark.parametrize("ask", [lambda: chosen_experiments(["ofice"]), lambda: chosen_methods("defualt")])
def test_unknown_name_lists_those_there_are(ask):
    with pytest.raises(ConfigurationError, match=r"no (experiment|method) '\w+'; there are .*(office-z30|paper)"):
        ask()


def test_run_out_of_time_reports_what_there_is_and_goes_on_later(tmp_path):
    plan = toy.toy_plan()
    assert evaluate(plan, tmp_path, deadline=0.0) == []
    some = evaluate(plan, tmp_path, deadline=time.monotonic() + 0.05)
    assert len(evaluate(plan, tmp_path, deadline=0.0)) == len(some)
    assert len(evaluate(plan, tmp_path)) == 40


def test_rows_of_other_code_are_not_taken(tmp_path, monkeypatch):
    calls = tmp_path / "calls.txt"
    evaluate(toy.toy_plan(str(calls)), tmp_path)
    monkeypatch.setattr("magmatch_evaluation.trial.code_digest", lambda: "another")
    evaluate(toy.toy_plan(str(calls)), tmp_path)
    assert len(calls.read_text().splitlines()) == 80


def test_workers_of_a_scheduler_give_the_same_table(tmp_path):
    distributed = pytest.importorskip("distributed")
    plan = toy.toy_plan()
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None, silence_logs=50
    )
    with cluster:
        there = evaluate(plan, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert toy.tables(plan, there) == toy.tables(plan, evaluate(plan, tmp_path / "here"))


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://127.0.0.1:9", "no Dask scheduler answers at tcp://127.0.0.1:9"),
        ("there", "expected an address such as"),
    ],
)
def test_scheduler_that_is_none_is_named(tmp_path, monkeypatch, address, words):
    pytest.importorskip("distributed")
    monkeypatch.setattr("magmatch.workers.CONNECT_SECONDS", 0.3)
    with pytest.raises(ConfigurationError, match=words):
        evaluate(toy.toy_plan(), tmp_path, scheduler=address)
