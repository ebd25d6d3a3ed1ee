# SPDX-License-Identifier: BSD-3-Clause
"""Nothing is told by hue alone: shapes, dashes and lightness carry it too."""

from itertools import combinations

import numpy as np
import pytest

pytest.importorskip("plotly")

from plotly.colors import get_colorscale, hex_to_rgb, sample_colorscale, unlabel_rgb

from magmatch.viz.figures.agreement_figures import agreement_figures, along_figure, compare
from magmatch.viz.figures.certainty_figures import ellipsoid_figure, ellipsoids_at, free_figure, poses_figure
from magmatch.viz.figures.draw import (
    BASE_COLOR,
    DARK,
    FIELD_SCALE,
    INK,
    LINK_COLOR,
    PAPER,
    SPREAD_SCALE,
    TARGET_COLOR,
)
from magmatch.viz.figures.registration_figures import match_figure, scene_figures, shown_pose
from magmatch.viz.figures.survey_figures import profile_figure

# WCAG 2.2, 1.4.11: what must be told apart contrasts at least this much.
LEAST_CONTRAST = 3.0


def luminance(rgb):
    c = np.asarray(rgb, dtype=float) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a, b):
    dark, light = sorted(luminance(hex_to_rgb(c)) + 0.05 for c in (a, b))
    return light / dark


@pytest.mark.parametrize(("a", "b"), list(combinations([BASE_COLOR, TARGET_COLOR, "#FFFFFF"], 2)))
def test_both_surveys_and_the_paper_differ_in_grey(a, b):
    assert contrast(a, b) >= LEAST_CONTRAST


def test_what_is_drawn_stands_out_in_the_dark_theme_too():
    for color in (BASE_COLOR, TARGET_COLOR, LINK_COLOR, INK):
        assert contrast(DARK[color], DARK[PAPER]) >= LEAST_CONTRAST


@pytest.mark.parametrize("scale", [FIELD_SCALE, SPREAD_SCALE])
def test_colour_scales_rise_in_lightness(scale):
    colors = sample_colorscale(get_colorscale(scale), np.linspace(0, 1, 40).tolist())
    grey = [luminance(unlabel_rgb(color)) for color in colors]
    assert (np.diff(grey) > 0).all()


def look(trace):
    """All that tells a series apart except its colour."""
    marker, line = getattr(trace, "marker", None), getattr(trace, "line", None)
    mode = trace.mode if "mode" in trace else None
    shape = marker.symbol if mode == "markers" else None
    dash = (line.dash or "solid", line.width) if mode == "lines" else None
    return trace.type, mode, shape, dash, getattr(trace, "fill", None)


def test_no_series_is_told_by_hue_alone(pair):
    T, refused = pair.accepted.T_base_target, pair.refused
    compared = compare(pair.base_map, pair.target_map, T, pair.accepted)
    place, _ = ellipsoids_at(pair.accepted.covariance, T, pair.target.centroid)
    figures = [
        *scene_figures(pair.base, pair.target, pair.accepted),
        match_figure(pair.base, pair.target, pair.accepted.links),
        *agreement_figures(pair.base_map, compared),
        along_figure(compared),
        profile_figure(pair.base),
        ellipsoid_figure(place, "place", "mm", 1e3, ""),
        poses_figure(pair.base, pair.target, [T, T.inv(), T * T, T, T, T]),
        free_figure(pair.base, pair.target, shown_pose(refused), refused.degenerate_directions[0]),
    ]
    for figure in figures:
        named = [trace for trace in figure.data if trace.name and trace.showlegend is not False]
        looks = [look(trace) for trace in named]
        assert len(set(looks)) == len(looks), figure.layout.title.text
