# SPDX-License-Identifier: BSD-3-Clause
"""`magmatch view`: pages and recordings."""

import sys

import pytest


def test_a_recording_is_written_instead_of_a_page(place, run, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.chdir(tmp_path)
    files = (place / "result.json", place / "base.map", place / "target.map")
    outcome = run("view", *files, "--rerun", "o.rrd")
    assert (outcome.code, outcome.out) == (0, "o.rrd\n")
    assert [path.name for path in tmp_path.iterdir()] == ["o.rrd"]


def test_a_page_and_a_recording_are_written_where_both_are_asked_for(place, run, tmp_path):
    pytest.importorskip("rerun")
    pytest.importorskip("plotly")
    page, recording = tmp_path / "v.html", tmp_path / "o.rrd"
    assert run("view", place / "base.csv", "--out", page, "--rerun", recording).out == f"{page}\n{recording}\n"
    assert page.exists()
    assert recording.exists()


def test_a_result_alone_has_nothing_in_space(place, run, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.chdir(tmp_path)
    outcome = run("view", place / "result.json", "--rerun", "o.rrd")
    assert outcome.code == 2
    assert "give its base and target too" in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("module", "words", "extra"),
    [("rerun", ("--rerun", "o.rrd"), "rerun"), ("plotly.graph_objects", (), "viz")],
)
def test_a_missing_extra_is_one_line_that_names_it(place, run, monkeypatch, tmp_path, module, words, extra):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    outcome = run("view", place / "base.csv", *words)
    assert outcome.code == 2
    assert f"pip install '.[{extra}]'" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_surveys_that_come_with_a_result_are_mapped(place, run, tmp_path):
    pytest.importorskip("plotly")
    page = tmp_path / "v.html"
    files = [place / name for name in ("result.json", "base.csv", "target.csv")]
    assert run("view", *files, "--out", page).code == 0
    for words in ("The field of both maps", "Residual at every sample", "Position of the target"):
        assert words in page.read_text()
