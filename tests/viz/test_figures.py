# SPDX-License-Identifier: BSD-3-Clause
"""Figures show what the nouns hold, with units, in colours and shapes that everyone can tell apart."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.geometry import transform_points
from magmatch.registration.result import Links

pytest.importorskip("plotly")

from magmatch.viz.figures.agreement_figures import along_figure, compare
from magmatch.viz.figures.certainty_figures import poses_figure
from magmatch.viz.figures.draw import thinned
from magmatch.viz.figures.map_figures import field_figures, spread_figure
from magmatch.viz.figures.registration_figures import scene_figures, slice_figures
from magmatch.viz.figures.slices import common_limits, cut_through
from magmatch.viz.figures.survey_figures import profile_figure, survey_figure


def xyz(trace):
    return np.column_stack([trace.x, trace.y, trace.z])


def test_after_registration_the_target_lies_in_the_base_frame(pair):
    before, after = scene_figures(pair.base, pair.target, pair.accepted)
    np.testing.assert_allclose(xyz(before.data[1]), pair.target.positions, atol=1e-6)
    moved = transform_points(pair.target.positions, pair.accepted.T_base_target)
    np.testing.assert_allclose(xyz(after.data[1]), moved, atol=1e-6)
    np.testing.assert_allclose(xyz(before.data[0]), xyz(after.data[0]))
    # Links shrink to nothing where the transform is right.
    ends = (xyz(figure.data[-1]).reshape(-1, 3, 3) for figure in (before, after))
    apart, together = (np.linalg.norm(rows[:, 0] - rows[:, 1], axis=1).max() for rows in ends)
    assert apart > 0.1
    assert together < 1e-5


def test_links_and_keypoints_are_hidden_until_asked_for(pair):
    for figure in scene_figures(pair.base, pair.target, pair.accepted):
        assert [trace.visible for trace in figure.data] == [None] * 2 + ["legendonly"] * 3
        assert all(trace.marker.size < 4 for trace in figure.data if trace.visible is None)


def test_a_refused_pose_is_called_so(pair):
    after = scene_figures(pair.base, pair.target, pair.refused)[1]
    assert "NOT accepted" in after.layout.title.text


def test_slices_share_one_scale_in_microtesla_and_differ_little_where_both_maps_know_the_field(pair):
    base, target, difference = slice_figures(pair.base_map, pair.target_map, pair.accepted)
    assert (base.data[0].zmin, base.data[0].zmax) == (target.data[0].zmin, target.data[0].zmax)
    assert 10 < np.nanmedian(base.data[0].z) < 200
    assert base.data[0].colorbar.ticksuffix == " uT"
    assert difference.data[0].zmin == 0
    assert np.nanmedian(difference.data[0].z) < 0.05 * (base.data[0].zmax - base.data[0].zmin)


def test_a_flat_box_is_cut_parallel_to_its_flat_side():
    rng = np.random.default_rng(0)
    assert cut_through(rng.uniform(0, 1, (50, 3)) * [2, 0.2, 1]).axes == (0, 2, 1)
    assert cut_through(rng.uniform(0, 1, (50, 3))).axes == (0, 1, 2)


def test_a_cut_through_one_line_is_a_picture_still():
    p = np.column_stack([np.linspace(0, 5, 20), np.zeros(20), np.zeros(20)])
    cut = cut_through(p)
    assert len(cut.points) == len(cut.first) * len(cut.second) < 2000


def test_colour_limits_of_nothing_and_of_a_constant_are_a_range():
    for values in (np.zeros(0), np.full(5, 48.0)):
        low, high = common_limits(values)
        assert high > low


@pytest.mark.parametrize("n", [1, 5000, 123_456])
def test_thinning_keeps_the_ends_and_repeats_nothing(n):
    rows = thinned(n)
    assert (rows[0], rows[-1]) == (0, n - 1)
    assert len(np.unique(rows)) == len(rows) == min(n, 5000)


def test_every_axis_says_its_unit(pair):
    cut = cut_through(pair.base.positions)
    figures = [survey_figure(pair.base), profile_figure(pair.base), profile_figure(pair.target)]
    figures += [
        *field_figures(pair.base_map),
        spread_figure(pair.base_map, cut, np.ones(len(cut.points))),
        *scene_figures(pair.base, pair.target, pair.accepted),
    ]
    figures += slice_figures(pair.base_map, pair.target_map, pair.accepted)
    for figure in figures:
        layout = figure.to_dict()["layout"]
        axes = layout.get("scene", layout)
        titles = [axes[name]["title"]["text"] for name in ("xaxis", "yaxis")]
        assert all(any(unit in title for unit in ("(m)", "(uT)", "(s)", "sample")) for title in titles)


UTM = np.array([691234.5, 5334567.25, 512.0])


@pytest.fixture(scope="module")
def far(pair):
    """The pair in a frame of UTM, both of them."""
    T = RigidTransform.from_translation(UTM)
    base, target = (replace(s.transformed(T), name=s.name) for s in (pair.base, pair.target))
    T_base_target = T * pair.accepted.T_base_target * T.inv()
    links = Links(pair.accepted.links.base + UTM, pair.accepted.links.target + UTM)
    return base, target, replace(pair.accepted, T_base_target=T_base_target, links=links)


def drawn_off(axis_titles):
    """What the titles of axes say was taken off."""
    found = [re.match(r"[xyz](?: - (\d+))? \(m\)", title) for title in axis_titles]
    return np.array([float(m[1] or 0) for m in found])


def test_samples_far_from_the_origin_are_drawn_where_they_are(pair, far):
    base, target, result = far
    figure = survey_figure(base)
    off = drawn_off(figure.layout.scene[f"{axis}axis"].title.text for axis in "xyz")
    np.testing.assert_array_equal(off, [691000, 5334000, 0])
    # Single precision keeps 0.1 mm of what lies within a kilometre.
    np.testing.assert_allclose(xyz(figure.data[0]) + off, base.positions, atol=1e-4)
    before, after = scene_figures(base, target, result)
    moved = transform_points(target.positions, result.T_base_target)
    for drawn, p in ((before, target.positions), (after, moved)):
        np.testing.assert_allclose(xyz(drawn.data[1]) + off, p, atol=1e-4)
    rows = xyz(after.data[-1]).reshape(-1, 3, 3)
    assert np.linalg.norm(rows[:, 0] - rows[:, 1], axis=1).max() < 1e-3


def test_frames_that_lie_far_apart_are_overlaid_about_their_own_origins(pair, far):
    base, _, result = far
    links = Links(result.links.base, pair.accepted.links.target)
    before, _ = scene_figures(base, pair.target, replace(result, links=links))
    assert "about (691000, 5334000, 0) and (0, 0, 0) m" in before.layout.title.text
    np.testing.assert_allclose(xyz(before.data[0]), base.positions - [691000, 5334000, 0], atol=1e-4)
    np.testing.assert_allclose(xyz(before.data[1]), pair.target.positions, atol=1e-6)


def test_a_plan_far_from_the_origin_names_what_it_takes_off(far):
    base, target, result = far
    here = result.T_base_target
    figure = poses_figure(base, target, [here, RigidTransform.from_translation([5.0, 0, 0]) * here])
    off = drawn_off(figure.layout[f"{axis}axis"].title.text for axis in "xy")
    np.testing.assert_array_equal(off, [691000, 5334000])
    dots = np.column_stack([figure.data[0].x, figure.data[0].y])
    np.testing.assert_allclose(dots + off, base.positions[:, :2], atol=1e-4)
    assert "1 around x 69123" in figure.layout.meta["alt"]
    cut = cut_through(base.positions)
    np.testing.assert_allclose(np.diff(cut.first.astype(np.float32)), np.diff(cut.first), rtol=0.01)
    np.testing.assert_allclose(cut.along(cut.points)[: len(cut.first), 0], cut.first, atol=1e-8)


def test_names_are_text_not_markup(pair):
    survey = replace(pair.base, name="<a href='x'>b</a>")
    assert "<a" not in survey_figure(survey).layout.title.text


def test_the_band_is_not_drawn_across_gaps(pair):
    T = pair.accepted.T_base_target * RigidTransform.from_translation([1.5, 0, 0])
    compared = compare(pair.base_map, pair.target_map, T, pair.accepted)
    assert 0.1 < compared.overlap < 0.999
    band = next(trace for trace in along_figure(compared).data if trace.fill == "toself")
    pieces = np.split(band.x, np.flatnonzero(np.isnan(band.x)) + 1)
    known = set(compared.rows[compared.is_known].tolist())
    for piece in pieces:
        rows = set(piece[np.isfinite(piece)].tolist())
        assert rows <= known
        assert not rows or max(rows) - min(rows) + 1 == len(rows)


def test_rival_poses_are_drawn_where_the_target_would_lie(pair):
    T = pair.accepted.T_base_target
    away = RigidTransform.from_translation([5.0, 0, 0]) * T
    figure = poses_figure(pair.base, pair.target, [T, away])
    outlines = [trace for trace in figure.data if trace.mode == "lines"]
    assert [trace.name for trace in outlines] == ["pose 1", "pose 2"]
    np.testing.assert_allclose(np.sort(outlines[1].x) - np.sort(outlines[0].x), 5.0, atol=1e-5)
    assert outlines[0].line.dash != outlines[1].line.dash
    assert [trace.text[0] for trace in figure.data if trace.mode == "text"] == ["<b>1</b>", "<b>2</b>"]


def test_a_straight_line_has_an_outline_too(pair):
    p = np.column_stack([np.linspace(0, 2, 50), np.zeros(50), np.zeros(50)])
    line = replace(pair.target, positions=p[::-1], field=np.full(p.shape, 3e-5))
    assert len(poses_figure(pair.base, line, [RigidTransform.identity()]).data[1].x) == 50


def test_a_wide_band_does_not_flatten_the_field(pair):
    compared = compare(pair.base_map, pair.target_map, pair.accepted.T_base_target, pair.accepted)
    vague = replace(compared, expected_sd=np.full_like(compared.expected_sd, 1e-3))
    for k, axis in enumerate(("yaxis", "yaxis2", "yaxis3")):
        low, high = along_figure(vague).layout[axis].range
        lines = 1e6 * np.concatenate([compared.measured[:, k], compared.expected[compared.is_known, k]])
        assert low <= lines.min() <= lines.max() <= high
        assert high - low < 1.5 * np.ptp(lines)
