# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a registration: both surveys before and after, and the field of both maps on one cut."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import transform_points
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Points
from magmatch.viz.plotting import (
    BASE_COLOR,
    BASE_MARKER,
    LINK_COLOR,
    SPREAD_SCALE,
    TARGET_COLOR,
    TARGET_MARKER,
    UT_PER_TESLA,
    for_display,
    label,
    lines3d,
    magnitude_ut,
    new_scene,
    points3d,
    thinned,
)
from magmatch.viz.slices import common_limits, cut_through, field_on, magnitude_slice, slice_figure

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Few enough that single links can be followed.
MAX_LINKS = 60
MAX_SCENE_SAMPLES = 3000


def shown_pose(result: RegistrationResult) -> RigidTransform | None:
    """Pose that pictures show: the accepted one, else the best candidate, else none."""
    if result.T_base_target is not None:
        return result.T_base_target
    return result.alternatives[0].T_base_target if result.alternatives else None


def scene_figures(base: Survey, target: Survey, result: RegistrationResult) -> "list[Figure]":
    """Both surveys in one frame: as they came, and with the target brought to the base.

    Parameters
    ----------
    base, target : Survey
        Each in its own frame.
    result : RegistrationResult

    Returns
    -------
    list of plotly Figure
        Before; and after, where there is a pose to show.
    """
    links = result.links
    before = new_scene(
        "Before: as recorded",
        _traces(base, target.positions, target, links.base, links.target),
        "each survey in its own frame, drawn over one another",
    )
    T_base_target = shown_pose(result)
    if T_base_target is None:
        return [before]
    moved = transform_points(links.target, T_base_target)
    p_base = transform_points(target.positions, T_base_target)
    title = "After: target in the base frame" if result.is_accepted else "Best candidate, NOT accepted"
    return [before, new_scene(title, _traces(base, p_base, target, links.base, moved), f"frame of {base.name}")]


def slice_figures(base_map: FieldMap, target_map: FieldMap, result: RegistrationResult) -> "list[Figure]":
    """Field magnitude of both maps on one cut of the base frame, and how far their vectors differ.

    Parameters
    ----------
    base_map, target_map : FieldMap
        Each in its own frame.
    result : RegistrationResult

    Returns
    -------
    list of plotly Figure
        Base, target brought to the base, difference; the base alone where there is no pose to show.
    """
    T_base_target = shown_pose(result)
    p_base = base_map.survey.positions
    if T_base_target is not None:
        p_moved = transform_points(target_map.survey.positions, T_base_target)
        p_base = np.concatenate([p_base, p_moved])
    cut = cut_through(p_base)
    field, is_known = field_on(cut, base_map)
    if T_base_target is None:
        limits = common_limits(magnitude_ut(base_map.survey.field))
        return [magnitude_slice("|B| of the base map", cut, field, is_known, limits)]
    brought, is_known_too = field_on(cut, target_map, T_base_target)
    # From the samples: between and beyond them a map may swing farther than anything that was measured.
    limits = common_limits(*(magnitude_ut(m.survey.field) for m in (base_map, target_map)))
    both = is_known & is_known_too
    apart = UT_PER_TESLA * np.linalg.norm(field - brought, axis=1)
    return [
        magnitude_slice("|B| of the base map", cut, field, is_known, limits),
        magnitude_slice("|B| of the target map, in the base frame", cut, brought, is_known_too, limits),
        slice_figure(
            "Difference of the field vectors, in magnitude",
            cut, apart, both, (0.0, common_limits(apart[both])[1]), SPREAD_SCALE,
        ),
    ]  # fmt: skip


def _traces(base: Survey, p_target: Points, target: Survey, link_base: Points, link_target: Points) -> list[Any]:
    """Both surveys with their links."""
    traces = [
        _samples(base.positions, base, f"base: {base.name}", BASE_COLOR, BASE_MARKER),
        _samples(p_target, target, f"target: {target.name}", TARGET_COLOR, TARGET_MARKER),
    ]
    if not len(link_base):
        return traces
    rows = thinned(len(link_base), MAX_LINKS)
    ends = [
        ("keypoints of base", link_base, BASE_COLOR, "square-open", 7),
        ("keypoints of target", link_target, TARGET_COLOR, "diamond-open", 7),
    ]
    traces += [
        points3d(p[rows], name=name, marker={"size": size, "color": color, "symbol": symbol}, hoverinfo="name")
        for name, p, color, symbol, size in ends
    ]
    links = lines3d(link_base[rows], link_target[rows], name="links", line={"color": LINK_COLOR, "width": 4})
    return [*traces, links]


def _samples(p: Points, survey: Survey, name: str, color: str, symbol: str) -> Any:
    rows = thinned(len(survey), MAX_SCENE_SAMPLES)
    return points3d(
        p[rows],
        name=label(name),
        marker={"size": 2 if len(rows) < 1000 else 1.5, "color": color, "symbol": symbol, "opacity": 0.5},
        customdata=for_display(magnitude_ut(survey.field[rows])),
        hovertemplate="%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>|B| %{customdata:.2f} uT",
    )
