# SPDX-License-Identifier: BSD-3-Clause
"""A map's report says what it was made from, what it knows, and how it came to be."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
import yaml

pytest.importorskip("plotly")

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.viz.figures.map_figures import (
    Coverage,
    cover_and_spread,
    field_figures,
    left_out,
    spread_figure,
)
from magmatch.viz.figures.slices import cut_through
from magmatch.viz.pages.map_page import MEANINGS, write_map_report

COMPARISON = {"spline": 1.1e-6, "harmonic": 1e-6}


@pytest.fixture(scope="module")
def page(pair, tmp_path_factory):
    compared = replace(pair.base_map, config=pair.base_map.config.model_copy(update={"comparison": COMPARISON}))
    odd = replace(pair.base, field=pair.base.field + 1e-4)
    path = tmp_path_factory.mktemp("map") / "m.html"
    write_map_report(path, compared, [pair.base, odd.subset(np.arange(3))], "magmatch map base.csv --out m.map")
    return unescape(path.read_text())


def test_it_says_what_the_map_is_made_from(page, pair):
    for words in (f"<td>{len(pair.base)}</td>", "frame 'survey'", "<td>spline</td>"):
        assert words in page


def test_it_explains_every_number_of_the_prior(page, pair):
    assert set(MEANINGS) == set(pair.base_map.hyperparameters.as_dict())
    for name, meaning in MEANINGS.items():
        assert name in page
        assert meaning in page


def test_it_compares_the_priors(page):
    table = page.split("Priors compared on held-out data")[1]
    assert table.index("harmonic") < table.index("spline")
    for words in ("1 uT", "1.1 uT", "+10 %", "<td>yes</td>"):
        assert words in table


def test_it_lists_what_was_left_out(page):
    assert "3 samples contradict their neighbours" in page
    assert page.split("Left out")[1].count("<tr>") >= 4


def test_its_settings_make_the_same_map_again(page, pair):
    settings = yaml.safe_load(re.search(r'<pre id="settings"[^>]*>(.*?)</pre>', page, re.DOTALL).group(1))
    again = build_map(pair.base, FieldConfig.model_validate(settings["field"]))
    assert np.array_equal(again.posterior.weights, pair.base_map.posterior.weights)
    assert "magmatch map base.csv --out m.map" in page


def cover(field_map) -> Coverage:
    return cover_and_spread(field_map, np.zeros((0, 3)))[0]


def test_coverage_counts_the_known_part_of_the_box(pair):
    coverage = cover(pair.base_map)
    assert 0.8 < coverage.known_share <= 1  # the box lies along the survey's own axes
    assert coverage.share_below(np.inf) == 1
    assert coverage.quantile(0.1) <= coverage.quantile(0.9)
    assert coverage.variation == pytest.approx(np.sqrt(pair.base.field.var(axis=0).mean()))


def test_coverage_sees_a_gap():
    rng = np.random.default_rng(0)
    p = np.concatenate([rng.uniform(0, 1, (60, 3)), 9 + rng.uniform(0, 1, (60, 3))])
    survey = Survey(p, np.full(p.shape, 3e-5) + 1e-6 * np.sin(3 * p))
    assert cover(build_map(survey, SPLINE)).known_share < 0.3


def test_a_thick_survey_is_cut_along_all_axes_a_flat_one_along_its_side_and_has_a_coverage_too(pair):
    assert len(field_figures(pair.base_map)) == 6
    flat = build_map(replace(pair.base, positions=pair.base.positions * [1, 1, 0]), SPLINE)
    assert len(field_figures(flat)) == 4
    assert cover(flat).known_share > 0.8


def test_left_out_samples_are_told_by_their_numbers(pair):
    is_out = np.zeros(len(pair.base), dtype=bool)
    is_out[[3, 50]] = True
    field_map = build_map(pair.base.subset(~is_out), FieldConfig(prior="spline", leave_out_outliers=False))
    assert np.array_equal(left_out(field_map, pair.base), is_out)


def test_samples_are_marked_on_the_picture_of_standard_deviations(pair):
    cut = cut_through(pair.base.positions)
    coverage, sd = cover_and_spread(pair.base_map, cut.points)
    np.testing.assert_allclose(coverage.sd, cover(pair.base_map).sd)
    heat, marks = spread_figure(pair.base_map, cut, sd).data
    np.testing.assert_allclose(np.nanmax(heat.z), 1e6 * sd[pair.base_map.knows(cut.points)].max())
    assert len(marks.x) == len(pair.base)
    assert np.nanmin(heat.z) >= 0
