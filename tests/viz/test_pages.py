# SPDX-License-Identifier: BSD-3-Clause
"""Pages stand alone, say the verdict in words, and stay small."""

import base64
import gzip
import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.errors import MissingExtraError
from magmatch.viz.pages import write_view
from magmatch.viz.plotting import require_plotly
from magmatch.viz.report import write_report

LIMIT = 5e6


@pytest.fixture
def report(pair, tmp_path):
    pytest.importorskip("plotly")
    write_report(tmp_path / "r.html", pair.base_map, pair.target_map, pair.accepted)
    return (tmp_path / "r.html").read_text()


def figures_in(page):
    return [
        json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    ]


def test_a_report_needs_no_network(report):
    without_data = re.sub(r"<script type=.*?</script>", "", report, flags=re.DOTALL)
    assert not re.search(r"(src|href)\s*=|https?://|@import|url\(", without_data)


def test_the_plotting_script_is_inside_once(report):
    packed = re.findall(r'<script type="text/plain" id="plotly">(.*?)</script>', report)
    assert len(packed) == 1
    assert b"newPlot" in gzip.decompress(base64.b64decode(packed[0]))


def test_a_report_says_the_verdict_in_words(report):
    said = ["Accepted", "probability of being right 0.997", "10 of 10 cells agree", "90% of the target", "0.573 deg"]
    said += ["10.0 mm", "100, 0, 0 nT", "Other poses", "&quot;search&quot;: &quot;invariants&quot;", "aa", "seed 0"]
    for words in said:
        assert words in report


def test_a_report_draws_scenes_and_slices(report):
    kinds = [figure["data"][0]["type"] for figure in figures_in(report)]
    assert kinds == ["scatter3d", "scatter3d", "heatmap", "heatmap", "heatmap"]


def test_a_report_fits_a_phone(report):
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in report


def test_a_refusal_says_why_and_gives_no_transform(pair, tmp_path):
    pytest.importorskip("plotly")
    write_report(tmp_path / "r.html", pair.base, pair.target, pair.refused)
    page = (tmp_path / "r.html").read_text()
    for words in ("Not accepted: degenerate", "sliding along base x", "No transform is given"):
        assert words in page
    assert len(figures_in(page)) == 2  # surveys only, since there are no maps


def test_the_same_result_gives_the_same_page(pair, tmp_path):
    pytest.importorskip("plotly")
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, pair.base_map, pair.target_map, pair.accepted)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_names_cannot_break_out_of_the_page(pair, tmp_path):
    pytest.importorskip("plotly")
    evil = "</script><script>alert(1)</script>"
    inputs = ({"name": evil, "sha256": "a"}, {"name": evil, "sha256": "b"})
    base = replace(pair.base, name=evil)
    write_report(
        tmp_path / "r.html", base, replace(pair.target, name=evil), replace(pair.accepted, inputs=inputs, reason=evil)
    )
    write_view(tmp_path / "v.html", [base])
    for name in ("r.html", "v.html"):
        assert "<script>alert" not in (tmp_path / name).read_text()


def test_a_hundred_thousand_samples_stay_under_five_megabytes(pair, tmp_path):
    pytest.importorskip("plotly")
    rng = np.random.default_rng(0)
    p = rng.uniform(0, 50, (100_000, 3))
    large = Survey(p, rng.normal(3e-5, 5e-6, p.shape), times=np.arange(100_000.0), name="large.csv")
    write_report(tmp_path / "r.html", large, large, pair.accepted)
    write_view(tmp_path / "v.html", [large, large])
    assert (tmp_path / "r.html").stat().st_size < LIMIT
    assert (tmp_path / "v.html").stat().st_size < LIMIT


def test_a_map_is_viewed_with_its_standard_deviation(pair, tmp_path):
    pytest.importorskip("plotly")
    write_view(tmp_path / "v.html", [pair.base_map, pair.target])
    page = (tmp_path / "v.html").read_text()
    assert "Standard deviation" in page
    assert len(figures_in(page)) == 5


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(MissingExtraError, match=r"magmatch\[viz\]"):
        require_plotly()
