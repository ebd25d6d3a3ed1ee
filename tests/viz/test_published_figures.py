# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the published method show every keypoint and every link, and frames that are frames."""

import numpy as np
import pytest

from magmatch.features.config import FeatureConfig
from magmatch.features.infer import infer
from magmatch.features.keypoints import detect
from magmatch.features.local_frames import local_frames
from magmatch.published.config import PublishedConfig
from magmatch.registration.result import NO_LINKS, Links

pytest.importorskip("plotly")

from magmatch.viz.figures.published_figures import curvature_figure, linked_keypoints_figure, local_frames_figure
from magmatch.viz.pages.registration_page import write_report

CONFIG = FeatureConfig(max_points=3000)


@pytest.fixture(scope="module")
def seen(pair):
    at = [infer(m, CONFIG) for m in (pair.base_map, pair.target_map)]
    return at, [local_frames(one, detect(one, CONFIG), CONFIG) for one in at]


def xyz(trace):
    return np.column_stack([trace.x, trace.y, trace.z])


def named(figure, name):
    return next(trace for trace in figure.data if trace.name == name)


def test_all_keypoints_and_all_links_are_drawn_and_the_maps_lie_side_by_side(seen):
    at, frames = seen
    n = min(map(len, frames))
    ends = [one.positions[some.rows[:n]] for one, some in zip(at, frames, strict=True)]
    figure = linked_keypoints_figure(*at, *(some.rows for some in frames), Links(*ends))
    base, target = (xyz(named(figure, f"keypoints of {side}")) for side in ("base", "target"))
    assert (len(base), len(target)) == tuple(map(len, frames))
    assert base[:, 0].max() < target[:, 0].min()
    lines = xyz(named(figure, "links")).reshape(-1, 3, 3)
    np.testing.assert_allclose(lines[:, 0], base[:n], atol=1e-6)
    np.testing.assert_allclose(lines[:, 1], target[:n], atol=1e-6)
    assert f"{n} links" in figure.layout.meta["alt"]
    assert (
        "0 links" in linked_keypoints_figure(*at, frames[0].rows[:0], frames[1].rows[:0], NO_LINKS).layout.meta["alt"]
    )


def test_the_slice_of_curvature_shows_keypoints_near_it(seen):
    at, frames = seen
    heat, marks = curvature_figure(at[0], frames[0].rows).data
    assert 0 < len(marks.x) <= len(frames[0])
    assert np.isfinite(np.asarray(heat.z, dtype=float)).any()
    assert "X*" not in curvature_figure(at[0], frames[0].rows[:0]).layout.meta["alt"]


def test_local_frames_are_drawn_where_the_keypoints_are_and_at_right_angles(seen):
    at, frames = seen
    figure = local_frames_figure(at[0], frames[0], np.arange(2))
    ends = np.stack([xyz(named(figure, f"{axis} axes")).reshape(-1, 3, 3)[:, :2] for axis in "xyz"])
    steps = ends[:, :, 1] - ends[:, :, 0]
    np.testing.assert_allclose(ends[0, :, 0], at[0].positions[frames[0].rows[:2]], atol=1e-6)
    np.testing.assert_allclose(np.einsum("ikc,jkc->kij", steps, steps)[:, 0, 1:], 0, atol=1e-5)


def test_the_report_of_the_published_method_shows_what_it_saw(pair, tmp_path):
    write_report(
        tmp_path / "r.html", pair.base_map, pair.target_map, pair.accepted, None, PublishedConfig(features=CONFIG)
    )
    text = (tmp_path / "r.html").read_text()
    said = ("What the published method sees", "Keypoints and links", "Determinant of the Hessian", "local frames")
    assert all(words in text for words in said)
