# SPDX-License-Identifier: BSD-3-Clause
"""Figures as files: what is drawn, whole files only, and what is said where no browser draws."""

import pytest

from magmatch.errors import ConfigurationError
from magmatch.features.config import FeatureConfig
from magmatch.published.config import PublishedConfig
from magmatch.viz.images import registration_figures, require_images, write_images

plotly_io = pytest.importorskip("plotly.io")
CONFIG = PublishedConfig(features=FeatureConfig(max_points=2000))


def test_the_published_method_adds_its_figures_to_those_of_any_registration(pair):
    figures = registration_figures(pair.base_map, pair.target_map, pair.accepted, CONFIG)
    assert list(figures) == ["in-space", "keypoints", "curvature", "frames"]
    assert list(registration_figures(pair.base_map, pair.target_map, pair.accepted, None)) == ["in-space"]


def test_each_figure_is_a_png_and_an_svg_in_a_new_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(
        plotly_io, "write_images", lambda fig, file, **_: [f.write_text(g) for f, g in zip(file, fig, strict=True)]
    )
    write_images(tmp_path / "new", {"one": "1", "two": "2"})
    written = {path.name: path.read_text() for path in (tmp_path / "new").iterdir()}
    assert written == {"one.png": "1", "one.svg": "1", "two.png": "2", "two.svg": "2"}


def test_a_browser_that_breaks_down_leaves_what_was_there(tmp_path, monkeypatch):
    (tmp_path / "one.png").write_text("old")

    def breaks(fig, file, **_):
        file[0].write_text("half")
        raise RuntimeError

    monkeypatch.setattr(plotly_io, "write_images", breaks)
    with pytest.raises(RuntimeError):
        write_images(tmp_path, {"one": "1"})
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("one.png", "old")]


def test_no_browser_is_said_before_the_work(monkeypatch):
    monkeypatch.setattr("magmatch.viz.images.import_extra", lambda *_: None)

    def none(*_):
        raise RuntimeError("no Chrome")

    monkeypatch.setattr("plotly.graph_objects.Figure.to_image", none)
    with pytest.raises(ConfigurationError, match="drawn by Chrome or Chromium, which did not start"):
        require_images()


def test_images_are_images(tmp_path):
    pytest.importorskip("kaleido")
    try:
        require_images()
    except ConfigurationError:
        pytest.skip("no browser")
    import plotly.graph_objects as go

    write_images(tmp_path, {"line": go.Figure(go.Scatter(y=[0, 1]))})
    assert (tmp_path / "line.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "line.svg").read_bytes()[:200]
