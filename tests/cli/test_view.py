# SPDX-License-Identifier: BSD-3-Clause
"""Pictures: `magmatch view`, recordings, `register --figures`, and what each needs installed."""

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


def test_a_page_that_nobody_named_replaces_no_file(place, run, tmp_path, monkeypatch):
    pytest.importorskip("plotly")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "result.html").write_text("a report")
    made = [run("view", place / "result.json").out for _ in range(2)]
    assert made == ["result-2.html\n", "result-3.html\n"]
    assert (tmp_path / "result.html").read_text() == "a report"
    assert run("view", place / "result.json", "--out", "result.html").out == "result.html\n"
    assert (tmp_path / "result.html").read_text() != "a report"


def test_a_result_alone_has_nothing_in_space(place, refused, tmp_path):
    pytest.importorskip("rerun")
    refused(["view", place / "result.json", "--rerun", tmp_path / "o.rrd"], "give its base and target too", tmp_path)


EXTRAS = {
    "rerun": ("rerun", ("view", "base.csv"), ("--rerun", "o.rrd")),
    "viz": ("plotly.graph_objects", ("view", "base.csv"), ()),
    "images": ("kaleido", ("register", "base.csv", "target.csv"), ("--figures", "figures")),
    "simulation": ("magpylib", ("simulate",), ("office", "--out", "pair")),
}


@pytest.mark.parametrize("extra", EXTRAS)
def test_a_missing_extra_is_one_line_that_names_it_before_the_work(extra, place, refused, monkeypatch, tmp_path):
    module, (command, *files), options = EXTRAS[extra]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    refused([command, *(place / name for name in files), *options], f"pip install '.[{extra}]'", tmp_path)


def test_figures_of_a_registration_are_written_into_the_folder_and_said(place, run, monkeypatch, tmp_path):
    plotly_io = pytest.importorskip("plotly.io")
    monkeypatch.setattr("magmatch.viz.images.require_images", lambda: None)
    monkeypatch.setattr(plotly_io, "write_images", lambda fig, file, **_: [f.write_bytes(b"") for f in file])
    outcome = run("register", place / "base.map", place / "target.map", "--figures", tmp_path / "figures")
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"in-space.png", "in-space.svg"}
    assert f"Wrote figures into {tmp_path / 'figures'}" in outcome.err


def test_surveys_that_come_with_a_result_are_mapped(place, run, tmp_path):
    pytest.importorskip("plotly")
    page = tmp_path / "v.html"
    files = [place / name for name in ("result.json", "base.csv", "target.csv")]
    assert run("view", *files, "--out", page).code == 0
    for words in ("The field of both maps", "Residual at every sample", "Position of the target"):
        assert words in page.read_text()
