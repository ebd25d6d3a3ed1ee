# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a registration: both surveys before and after, and the field of both maps on one cut."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import transform_points
from magmatch.number_text import told
from magmatch.registration.result import Links, RegistrationResult
from magmatch.typing import Points, Vector3
from magmatch.viz.figures import draw
from magmatch.viz.figures.slices import (
    common_limits,
    cut_through,
    field_on,
    limits_of,
    magnitude_slice,
    slice_figure,
)

# Hidden until its entry in the legend is clicked.
ASKED_FOR = {"visible": "legendonly", "showlegend": True}
# Few enough that single links can be followed.
MAX_LINKS, MAX_LINKS_ACROSS = 60, 25
MAX_SCENE_SAMPLES = 3000
# Samples that show where each survey lies beside the other, and the gap between both, of the wider one.
MAX_SAMPLES_ACROSS, GAP = 1500, 0.25


def shown_pose(result: RegistrationResult) -> RigidTransform | None:
    """Pose shown in pictures: the accepted one, else the best candidate in the base, else none."""
    if result.T_base_target is not None:
        return result.T_base_target
    # Poses in other maps of a folder cannot be drawn in this one.
    return next((other.T_base_target for other in result.alternatives if other.base is None), None)


def links_figure(result: RegistrationResult) -> draw.Figure:
    """Corresponding points of both sides in the frame of the base: all that a result alone can show."""
    T_base_target, links = shown_pose(result), result.links
    if T_base_target is None or not len(links.base):
        msg = "view: expected a result with pose and matching points, got one without; say view(result, base, target)"
        raise ValueError(msg)
    moved = transform_points(links.target, T_base_target)
    base = draw.marks3d(links.base, "base", draw.BASE_COLOR, draw.BASE_MARKER, 5)
    target = draw.marks3d(moved, "target", draw.TARGET_COLOR, draw.TARGET_MARKER, 4)
    words = "Corresponding points" if result.is_accepted else "Best candidate, NOT accepted"
    alt = f"{len(moved)} points of base and target in space."
    return draw.new_scene(words, [base, target], "frame of the base", alt)


def scene_figures(base: Survey, target: Survey, result: RegistrationResult) -> list[draw.Figure]:
    """Both surveys in one picture: as recorded, and with the target in the base's frame."""
    links = result.links
    off_base, off_target = draw.origins_of(base.positions, target.positions)
    if np.array_equal(off_base, off_target):
        off_base = off_target = np.zeros(3)  # the scene takes off what all have in common
    p_base, p_target = base.positions - off_base, target.positions - off_target
    both = f"Base {base.name} ({len(base)} samples, circles) and target {target.name} ({len(target)}, diamonds)"
    before = draw.new_scene(
        "Before: as recorded",
        _traces(base, p_base, target, p_target, links.base - off_base, links.target - off_target),
        f"each survey in its own frame, overlaid{_taken_off(off_base, off_target)}; {drawn_words(base, target)}",
        f"{both} in space, each in its own frame, with lines between matching keypoints.",
    )
    T_base_target = shown_pose(result)
    if T_base_target is None:
        return [before]
    moved = transform_points(links.target, T_base_target)
    p_moved = transform_points(target.positions, T_base_target)
    title = "After: target in the base frame" if result.is_accepted else "Best candidate, NOT accepted"
    apart = np.linalg.norm(links.base - moved, axis=1)
    gap = f"; matching keypoints are {np.median(apart):.3g} m apart in the median" if len(apart) else ""
    traces = _traces(base, base.positions, target, p_moved, links.base, moved)
    return [before, draw.new_scene(title, traces, f"frame of {base.name}", f"{both} in the frame of the base{gap}.")]


def slice_figures(base_map: FieldMap, target_map: FieldMap, result: RegistrationResult) -> list[draw.Figure]:
    """Field magnitude of both maps on one cut of the base frame, and how far their vectors differ."""
    T_base_target = shown_pose(result)
    p_base = [base_map.survey.positions]
    if T_base_target is not None:
        p_base.append(transform_points(target_map.survey.positions, T_base_target))
    cut = cut_through(np.concatenate(p_base))
    field, is_known = field_on(cut, base_map)
    if T_base_target is None:
        return [magnitude_slice("|B| of the base map", cut, field, is_known, limits_of(base_map))]
    brought, is_known_too = field_on(cut, target_map, T_base_target)
    limits, both = limits_of(base_map, target_map), is_known & is_known_too
    apart = draw.UT_PER_TESLA * np.linalg.norm(field - brought, axis=1)
    return [
        magnitude_slice("|B| of the base map", cut, field, is_known, limits),
        magnitude_slice("|B| of the target map", cut, brought, is_known_too, limits, note=", base frame"),
        slice_figure(
            "Difference of the vectors", cut, apart, both, (0.0, common_limits(apart[both])[1]), draw.SPREAD_SCALE
        ),
    ]


def match_figure(base: Survey, target: Survey, links: Links) -> draw.Figure | None:
    """Both surveys side by side, with lines between some of the matching keypoints."""
    if not len(links.base):
        return None
    rows = draw.thinned(len(links.base), MAX_LINKS_ACROSS)
    some = Links(links.base[rows], links.target[rows])
    counts = f"{len(rows)} of {len(links.base)} links drawn"
    return side_by_side(
        "Matching keypoints", (base.positions, target.positions), some, (some.base, some.target), counts
    )


def side_by_side(
    title: str, samples: tuple[Points, Points], links: Links, keypoints: tuple[Points, Points], counts: str
) -> draw.Figure:
    """Base and target beside each other in space, each in its own frame, with keypoints and lines between them."""
    width = max(float(np.ptp(p[:, 0])) for p in samples)
    shift = np.array([samples[0][:, 0].max() - samples[1][:, 0].min() + GAP * width, 0.0, 0.0])
    shift[1:] = (samples[0].mean(axis=0) - samples[1].mean(axis=0))[1:]
    traces = []
    for p, offset, name in zip(samples, (0.0, shift), ("samples", None), strict=True):
        some = p[draw.thinned(len(p), MAX_SAMPLES_ACROSS)] + offset
        style: dict[str, Any] = {"showlegend": name is not None, "hoverinfo": "skip"}
        traces.append(draw.marks3d(some, name, draw.QUIET, "cross", 1, **style))
    looks = ("base", draw.BASE_COLOR, draw.BASE_MARKER), ("target", draw.TARGET_COLOR, draw.TARGET_MARKER)
    for p, offset, (name, color, symbol) in zip(keypoints, (0.0, shift), looks, strict=True):
        traces.append(draw.marks3d(p + offset, f"keypoints of {name}", color, symbol, 1.5, hoverinfo="name"))
    line = {"color": draw.LINK_COLOR, "width": 1}
    if len(links.base):
        ends = draw.between(links.base, links.target + shift)
        traces.append(draw.curves3d(ends, name="links", line=line, opacity=0.4))
    words = f"left: base, right: target, each in its own frame; {counts}"
    alt = f"Base (left) and target (right) in space, each in its own frame, with lines between keypoints: {counts}."
    figure = draw.new_scene(title, traces, words, alt)
    # From the front, so that both lie beside each other rather than behind.
    return figure.update_layout(height=560, scene_camera={"eye": {"x": 0.15, "y": -1.5, "z": 0.9}})


def drawn_words(*surveys: Survey) -> str:
    """Words for how many samples of each survey are drawn, where these are not all."""
    words = [
        f"{MAX_SCENE_SAMPLES} of {len(survey)} samples of {survey.name} drawn"
        for survey in surveys
        if len(survey) > MAX_SCENE_SAMPLES
    ]
    return ", ".join(words) or "all samples drawn"


def _taken_off(*origins: Vector3) -> str:
    """Say where the origin of each frame stands in a picture of frames that are far from each other."""
    if not any(origin.any() for origin in origins):
        return ""
    said = (f"({', '.join(told(v) for v in origin)})" for origin in origins)
    return " about " + " and ".join(said) + " m"


def _traces(
    base: Survey, p_base: Points, target: Survey, p_target: Points, link_base: Points, link_target: Points
) -> list[Any]:
    """Both surveys with their links."""
    traces = [
        _samples(p_base, base, f"base: {base.name}", draw.BASE_COLOR, draw.BASE_MARKER),
        _samples(p_target, target, f"target: {target.name}", draw.TARGET_COLOR, draw.TARGET_MARKER),
    ]
    if not len(link_base):
        return traces
    rows = draw.thinned(len(link_base), MAX_LINKS)
    style: dict[str, Any] = {"hoverinfo": "name", **ASKED_FOR}
    line = {"color": draw.LINK_COLOR, "width": 4}
    return [
        *traces,
        draw.marks3d(link_base[rows], "keypoints of base", draw.BASE_COLOR, "square-open", 7, **style),
        draw.marks3d(link_target[rows], "keypoints of target", draw.TARGET_COLOR, "diamond-open", 7, **style),
        draw.curves3d(draw.between(link_base[rows], link_target[rows]), name="links", line=line, **ASKED_FOR),
    ]


def _samples(p: Points, survey: Survey, name: str, color: str, symbol: str) -> Any:
    rows = draw.thinned(len(survey), MAX_SCENE_SAMPLES)
    size, magnitude = 2 if len(rows) < 1000 else 1.5, draw.for_display(draw.magnitude_ut(survey.field[rows]))
    hover = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>|B| %{customdata:.2f} uT"
    style = {"customdata": magnitude, "hovertemplate": hover}
    return draw.marks3d(p[rows], draw.label(name), color, symbol, size, opacity=0.75, **style)
