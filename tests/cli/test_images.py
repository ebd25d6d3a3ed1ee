# SPDX-License-Identifier: BSD-3-Clause
"""`magmatch register --figures`."""

import sys

import pytest


def test_figures_without_the_extra_are_refused_before_the_work(place, run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "kaleido", None)
    outcome = run("register", place / "base.csv", place / "target.csv", "--figures", tmp_path / "figures")
    assert outcome.code == 2
    assert "pip install '.[images]'" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_figures_are_written_into_the_folder_and_said(place, run, monkeypatch, tmp_path):
    plotly_io = pytest.importorskip("plotly.io")
    monkeypatch.setattr("magmatch.viz.images.require_images", lambda: None)
    monkeypatch.setattr(plotly_io, "write_images", lambda fig, file, **_: [f.write_bytes(b"") for f in file])
    outcome = run("register", place / "base.map", place / "target.map", "--figures", tmp_path / "figures")
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"in-space.png", "in-space.svg"}
    assert f"Wrote figures into {tmp_path / 'figures'}" in outcome.err
