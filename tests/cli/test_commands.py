# SPDX-License-Identifier: BSD-3-Clause
"""Every command does its job end to end on a small place."""

import csv
import json
import re
import shlex
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from magmatch.data.read import read_survey
from magmatch.field.map import FieldMap
from magmatch.geometry import transform_error
from magmatch.registration.result import RegistrationResult


def read_csv(path: Path) -> tuple[list[str], np.ndarray]:
    rows = list(csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#")))
    return rows[0], np.array(rows[1:], dtype=float)


@pytest.fixture
def points(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("z,note,x,y\n0.1,a,0.2,0.3\n0.0,b,0.0,-0.4\n500,far,500,500\n")
    return path


def test_register_finds_the_truth(place):
    result = json.loads((place / "result.json").read_text())
    truth = json.loads((place / "truth.json").read_text())
    assert result["schema"] == "magmatch.registration/1"
    assert result["status"] == "accepted"
    T_estimate, T_true = (RigidTransform.from_matrix(np.array(r["T_base_target"])) for r in (result, truth))
    translation, rotation = transform_error(T_estimate, T_true, read_survey(place / "target.csv").centroid)
    assert translation < 0.03
    assert np.rad2deg(rotation) < 2


def test_register_prints_json_on_stdout_and_words_on_stderr(place, run, tmp_path):
    out = tmp_path / "r.json"
    outcome = run("register", place / "base.map", place / "target.map", "--json", "--out", out, "--seed", 0)
    assert outcome.code == 0
    printed, saved, before = (
        json.loads(t) for t in (outcome.out, out.read_text(), (place / "result.json").read_text())
    )
    assert printed["T_base_target"] == saved["T_base_target"] == before["T_base_target"]
    assert "Accepted" in outcome.err
    assert [entry["name"] for entry in printed["inputs"]] == ["base.csv", "target.csv"]


def test_a_result_is_a_configuration_to_run_again(place, run):
    outcome = run("register", place / "base.map", place / "target.map", "--config", place / "result.json", "--json")
    again, before = json.loads(outcome.out), json.loads((place / "result.json").read_text())
    assert again["config"] == before["config"]
    assert again["T_base_target"] == before["T_base_target"]


def test_a_constant_field_is_not_accepted_with_code_3(run, tmp_path):
    rng = np.random.default_rng(0)
    for name in ("base", "target"):
        p = rng.uniform(0, 2, (60, 3))
        rows = "\n".join(",".join(map(str, [*q, 2e-5, 0.0, -4e-5])) for q in p)
        (tmp_path / f"{name}.csv").write_text(f"x,y,z,bx,by,bz\n{rows}\n")
    outcome = run("register", tmp_path / "base.csv", tmp_path / "target.csv", "--json")
    assert outcome.code == 3
    result = json.loads(outcome.out)
    assert result["T_base_target"] is None
    assert result["status"] != "accepted"
    assert "Not accepted" in outcome.err


def test_transform_moves_positions_and_turns_vectors(place, run, tmp_path):
    out = tmp_path / "aligned.csv"
    assert run("transform", place / "target.csv", "--by", place / "result.json", "--out", out).code == 0
    T = RigidTransform.from_matrix(np.array(json.loads((place / "result.json").read_text())["T_base_target"]))
    target, aligned = read_survey(place / "target.csv"), read_survey(out)
    np.testing.assert_allclose(aligned.positions, T.apply(target.positions), atol=1e-12)
    np.testing.assert_allclose(aligned.field, T.rotation.apply(target.field), atol=1e-18)


def test_transform_of_a_map_is_a_map_or_its_samples(place, run, tmp_path):
    result = place / "result.json"
    assert run("transform", place / "target.map", "--by", result, "--out", tmp_path / "a.map").code == 0
    assert run("transform", place / "target.map", "--by", result, "--out", tmp_path / "a.csv").code == 0
    moved, samples = FieldMap.load(tmp_path / "a.map").survey, read_survey(tmp_path / "a.csv")
    np.testing.assert_allclose(moved.positions, samples.positions, atol=1e-12)


def test_query_answers_in_input_order(place, run, points, tmp_path):
    out = tmp_path / "p.csv"
    outcome = run("query", place / "base.map", points, "--out", out)
    assert outcome.code == 0
    assert "knows the field at 2 of them" in outcome.err
    names, rows = read_csv(out)
    assert names == ["x", "y", "z", "bx", "by", "bz", "sx", "sy", "sz"]
    np.testing.assert_array_equal(rows[:, :3], [[0.2, 0.3, 0.1], [0, -0.4, 0], [500, 500, 500]])
    field_map = FieldMap.load(place / "base.map")
    np.testing.assert_array_equal(rows[:2, 3:6], field_map.evaluate(rows[:2, :3]).field)
    assert (rows[2, 6:9] > 5 * rows[0, 6:9]).all()


def test_query_gradient_is_row_major(place, run, points, tmp_path):
    out = tmp_path / "p.csv"
    assert run("query", place / "base.map", points, "--out", out, "--gradient").code == 0
    names, rows = read_csv(out)
    assert names[9:] == ["bxx", "bxy", "bxz", "byx", "byy", "byz", "bzx", "bzy", "bzz"]
    p, step = rows[:1, :3], np.array([0, 0, 1e-4])
    field_map = FieldMap.load(place / "base.map")
    by_dz = (field_map.evaluate(p + step).field - field_map.evaluate(p - step).field)[0, 1] / 2e-4
    # Central difference of a spline of third order: exact but for rounding and the kink at a knot.
    assert rows[0, names.index("byz")] == pytest.approx(by_dz, rel=1e-3)


def test_query_takes_points_in_millimetres_and_no_options_of_logs(place, run, tmp_path):
    (tmp_path / "mm.csv").write_text("x,y,z\n200,300,100\n")
    run("query", place / "base.map", tmp_path / "mm.csv", "--length-unit", "mm", "--out", tmp_path / "b.csv")
    np.testing.assert_allclose(read_csv(tmp_path / "b.csv")[1][0, :3], [0.2, 0.3, 0.1], rtol=1e-9)
    assert "topic" not in run("query", "--help").out


def test_map_takes_its_settings_from_flags_and_file(place, run, tmp_path):
    (tmp_path / "c.yaml").write_text("field:\n  lengthscale: 0.8\n  noise_sd: 5e-7\n")
    words = ("map", place / "base.csv", "--config", tmp_path / "c.yaml", "--domain", "-1,-1,-0.5,1,1,0.5")
    assert run(*words, "--prior", "spline", "--out", tmp_path / "m.map").code == 0
    field_map = FieldMap.load(tmp_path / "m.map")
    assert field_map.hyperparameters.lengthscale == 0.8
    assert field_map.hyperparameters.noise_sd == 5e-7
    assert field_map.config.domain == (-1, -1, -0.5, 1, 1, 0.5)


def test_map_grows_in_its_place(place, run, tmp_path):
    path = tmp_path / "grown.map"
    path.write_bytes((place / "base.map").read_bytes())
    again, base = tmp_path / "again.csv", read_survey(place / "base.csv")
    replace(base, field=base.field + 1e-7 * np.random.default_rng(1).standard_normal(base.field.shape)).save(again)
    outcome = run("map", path, again, "--out", path)
    assert outcome.code == 0
    assert "Added 300 samples to 300\n" in outcome.err
    old, new = FieldMap.load(place / "base.map"), FieldMap.load(path)
    assert len(new.survey) == 600
    assert new.hyperparameters == old.hyperparameters
    assert np.array_equal(new.T_map_model.as_matrix(), old.T_map_model.as_matrix())
    for twice in (again, place / "base.csv"):
        outcome = run("map", path, twice, "--out", tmp_path / "surer.map")
        assert outcome.code == 2
        assert "holds the same samples as" in outcome.err


def test_units_are_stated_for_one_survey_or_all(place, run, tmp_path):
    survey = read_survey(place / "base.csv")
    rows = np.column_stack([1000 * survey.positions, 1e6 * survey.field])
    path = tmp_path / "ut.csv"
    np.savetxt(path, rows, delimiter=",", header="x,y,z,bx,by,bz", comments="", fmt="%.17g")
    facts = json.loads(run("info", path, "--field-unit", "uT", "--length-unit", "mm", "--json").out)
    plain = json.loads(run("info", place / "base.csv", "--json").out)
    np.testing.assert_allclose(facts["extent"], plain["extent"], rtol=1e-12)
    assert facts["field"]["median_magnitude"] == pytest.approx(plain["field"]["median_magnitude"])
    words = ("transform", path, "--by", place / "result.json", "--field-unit", "G", "--target-length-unit", "mm")
    assert run(*words, "--target-field-unit", "uT", "--out", tmp_path / "a.csv").code == 0
    assert len(read_survey(tmp_path / "a.csv")) == len(survey)


@pytest.mark.parametrize("name", ["base.csv", "base.map", "result.json"])
def test_info_tells_people_and_programs(name, place, run):
    table, data = run("info", place / name), run("info", place / name, "--json")
    assert (table.code, data.code) == (0, 0)
    assert json.loads(data.out)["kind"] == {"csv": "survey", "map": "map", "json": "registration"}[name.split(".")[1]]
    assert table.out.strip()


def test_info_tells_a_trajectory(run, tmp_path):
    (tmp_path / "p.tum").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n")
    facts = json.loads(run("info", tmp_path / "p.tum", "--json").out)
    assert (facts["kind"], facts["poses"]) == ("trajectory", 3)


def test_info_says_doubts_once(run, tmp_path):
    rows = "\n".join(f"{i / 10},0,0,2e-5,{1e-6 * (i % 3)},4e-5" for i in range(30))
    (tmp_path / "line.csv").write_text(f"x,y,z,bx,by,bz\n{rows}\n")
    outcome = run("info", tmp_path / "line.csv")
    assert "on one line" in outcome.out
    assert outcome.err == ""


def test_simulate_writes_the_same_pair_for_the_same_seed(run, tmp_path):
    for name in ("a", "b"):
        assert run("simulate", "uniform", "--out", tmp_path / name, "--seed", 3).code == 0
    for file in ("base.csv", "target.csv", "truth.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert {"T_base_target", "accept", "scenario", "seed", "version"} <= truth.keys()
    assert truth["seed"] == 3


def test_datasets_lists_licences(run):
    for words in (["datasets"], ["datasets", "list"]):
        outcome = run(*words)
        assert outcome.code == 0
        assert "kok" in outcome.out
        assert "licence: MIT" in outcome.out


def flat_copy(survey, path):
    rows = np.column_stack([survey.positions * [1, 1, 0], survey.field])
    np.savetxt(path, rows, delimiter=",", header="x,y,z,bx,by,bz", comments="", fmt="%.17g")
    return path


def test_warnings_of_files_come_before_the_work_and_once_for_all_files(run, tmp_path, place):
    survey = read_survey(place / "base.csv")
    names = ("first", "second", "third", "fourth", "fifth")
    copies = [flat_copy(survey.subset(slice(k, 300, 5)), tmp_path / f"{name}.csv") for k, name in enumerate(names)]
    outcome = run("map", *copies, "--prior", "spline", "--out", tmp_path / "flat.map")
    (said,) = [line for line in outcome.err.splitlines() if "on one plane" in line]
    assert said.startswith(f"warning: {copies[0]}: ")
    assert said.endswith(f"(also {copies[1]}, {copies[2]}, 2 others)")
    lines = [line for line in outcome.err.splitlines() if not line.startswith("Compiling")]
    assert lines.index(said) < next(k for k, line in enumerate(lines) if line.startswith("Mapped"))


def test_a_command_that_cannot_read_a_file_says_that_alone(refused, tmp_path, place):
    flat = flat_copy(read_survey(place / "base.csv"), tmp_path / "flat.csv")
    refused(["register", tmp_path / "missing.csv", flat], "missing.csv")


def test_demo_finds_the_truth_and_draws_it(run, tmp_path):
    pytest.importorskip("plotly")
    outcome = run("demo", "--out", tmp_path / "demo", "--json")
    assert outcome.code == 0
    assert json.loads(outcome.out)["status"] == "accepted"
    millimetres, degrees = map(float, re.search(r"truth: ([\d.]+) mm, ([\d.]+) deg", outcome.err).groups())
    assert millimetres < 20
    assert degrees < 1
    for name in ("result.json", "report.html"):
        assert str(tmp_path / "demo" / name) in outcome.err
        assert (tmp_path / "demo" / name).exists()


def test_demo_works_without_the_report(place, run, tmp_path, monkeypatch):
    result = RegistrationResult.load(place / "result.json")
    monkeypatch.setattr("magmatch.registration.register.register_keeping_maps", lambda *_, **__: (None, None, result))
    monkeypatch.setattr("magmatch.registration.maps.as_map", lambda *_: None)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    outcome = run("demo", "--out", tmp_path / "demo")
    assert outcome.code == 0
    assert "No report: " in outcome.err
    assert "pip install '.[viz]'" in outcome.err
    assert [path.name for path in (tmp_path / "demo").iterdir()] == ["result.json"]


def test_evaluate_lists_what_there_is(run):
    outcome = run("evaluate", "list")
    assert outcome.code == 0
    assert all(name in outcome.out for name in ("office-z30", "corridor", "default", "paper"))


@pytest.mark.slow
def test_the_quick_evaluation_runs_whole_and_goes_on_where_it_stood(run, tmp_path):
    for module in ("magpylib", "plotly"):
        pytest.importorskip(module, reason="surveys are simulated, the report has figures")
    words = ("evaluate", "--quick", "--out", tmp_path / "e")
    first, again = run(*words), run(*words)
    assert first.code == again.code == 0
    assert "| quick-office-x30 | default | 2 of 2 |" in first.out
    assert "| quick-nowhere | default | 0 of 2 |" in first.out
    assert "Nowhere in this run." in first.out  # where `default` is not ahead
    assert first.out == again.out
    assert (tmp_path / "e" / "report.html").stat().st_size < 5e6
    assert "0 of 18 trials" in first.err
    assert "0 of 18 trials" not in again.err  # all of them were there


def test_map_draws_its_report_and_says_each_step_where_asked(place, run, tmp_path):
    pytest.importorskip("plotly")
    out, report = tmp_path / "b.map", tmp_path / "b.html"
    outcome = run("map", place / "base.csv", "--prior", "spline", "--out", out, "--report", report, "--verbose")
    assert outcome.code == 0
    assert "fitting the field" in outcome.err
    assert f"Wrote the report to {report}" in outcome.err
    assert f"magmatch map {place / 'base.csv'} --config settings.yaml --out {out}" in report.read_text()


def test_what_a_report_says_to_run_gives_the_same_result(place, run, tmp_path, monkeypatch):
    pytest.importorskip("plotly")
    report = tmp_path / "r.html"
    words = ["register", place / "base.map", place / "target.map", "--seed", 7, "--sensor", "none", "--json"]
    first = json.loads(run(*words, "--report", report).out)
    page = unescape(report.read_text())
    command, settings = (
        re.search(rf'<pre id="{name}"[^>]*>(.*?)</pre>', page, re.DOTALL).group(1) for name in ("command", "settings")
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "settings.yaml").write_text(settings)
    again = json.loads(run(*shlex.split(command)[1:], "--json").out)
    for key in ("T_base_target", "covariance", "config", "seed", "reason"):
        assert again[key] == first[key]


def test_command_is_recorded_without_where_files_lie(monkeypatch):
    from magmatch_evaluation.program import _command

    words = ["magmatch", "evaluate", "office", "--out", "/home/me", "--seeds", "3", "--from=/data", "--minutes", "5"]
    monkeypatch.setattr(sys, "argv", words)
    assert _command() == "magmatch evaluate office --seeds 3"


@pytest.mark.parametrize(("unit", "said"), [("m", "z of 1.2"), ("mm", "z of 1200")])
def test_query_of_points_without_a_height_names_that_of_a_planar_map(unit, said, run, tmp_path):
    rng = np.random.default_rng(0)
    p = np.column_stack([rng.uniform(0, 2, (40, 2)), np.full(40, 1.2)])
    numbers = mm.FieldConfig(prior="spline", lengthscale=1.0, signal_sd=5e-6, noise_sd=1e-7, spacing=0.5)
    for name, lifted in (("floor.map", p), ("room.map", p + np.outer(np.arange(40), [0, 0, 0.05]))):
        mm.build_map(mm.Survey(lifted, 1e-6 * rng.normal([20, 0, -45], 2, (40, 3))), numbers).save(tmp_path / name)
    (tmp_path / "points.csv").write_text("x,y\n1,1\n")
    asked = [tmp_path / "points.csv", "--length-unit", unit, "--out", tmp_path / "field.csv"]
    words = run("query", tmp_path / "floor.map", *asked).err
    assert "missing z; found x, y" in words
    assert f"a column {said}" in words
    assert "a column z of" not in run("query", tmp_path / "room.map", *asked).err
