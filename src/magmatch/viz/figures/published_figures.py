# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the published method: keypoints of both maps with their links, det H, and local frames in the field."""

from typing import Any

import numpy as np

from magmatch.features.infer import Inferred, infer
from magmatch.features.keypoints import curvature_response, detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.field.map import FieldMap
from magmatch.published.config import PublishedConfig
from magmatch.published.recursion import recursively
from magmatch.published.register import comparable
from magmatch.registration.result import Links
from magmatch.typing import Indices
from magmatch.viz.figures import draw
from magmatch.viz.figures.registration_figures import side_by_side
from magmatch.viz.figures.slices import common_limits, cut_normal_to, cut_through, heatmap

# Arrows that can still be told apart.
MAX_ARROWS = 400
# Axes x, y, z of a local frame, as everywhere.
AXES = ("#D62728", "#2CA02C", "#1F77B4")


def published_figures(
    base: FieldMap, target: FieldMap, links: Links, config: PublishedConfig
) -> dict[str, draw.Figure]:
    """Keypoints of both maps with their links, and what is behind those of the base, by name."""
    # Asked again: a result keeps the links alone.
    base, target = (recursively(m) if config.is_recursive else m for m in (base, target))
    features = comparable(base, target, config).features
    first, second = (infer(one, features) for one in (base, target))
    frames, others = (local_frames(one, detect(one, features), features) for one in (first, second))
    figures = {"keypoints": linked_keypoints_figure(first, second, frames.rows, others.rows, links)}
    if len(frames):
        figures |= {"curvature": curvature_figure(first, frames.rows), "frames": local_frames_figure(first, frames)}
    return figures


def linked_keypoints_figure(
    base: Inferred, target: Inferred, base_rows: Indices, target_rows: Indices, links: Links
) -> draw.Figure:
    """Both maps side by side in space, each in its own frame, with all keypoints and lines between matching ones."""
    sides = base.field_map.survey.positions, target.field_map.survey.positions
    keypoints = base.positions[base_rows], target.positions[target_rows]
    counts = f"{len(base_rows)} and {len(target_rows)} keypoints, {len(links.base)} links"
    return side_by_side("Keypoints and links", sides, links, keypoints, counts)


def curvature_figure(inferred: Inferred, rows: Indices) -> draw.Figure:
    """Determinant of the Hessian of |B| on the layer of X* with most keypoints, and those keypoints."""
    p = inferred.field_map.survey.positions
    normal = cut_through(p).axes[2]
    heights = inferred.positions[rows if len(rows) else slice(None)][:, normal]
    counts, edges = np.histogram(heights, bins=max(1, round(float(np.ptp(heights)) / inferred.spacing)))
    k = int(counts.argmax())
    cut = cut_normal_to(p, normal, float(edges[k] + edges[k + 1]) / 2)
    # Its cube root, a typical second derivative: the determinant itself has a few spikes and nothing else.
    response = draw.UT_PER_TESLA * np.cbrt(curvature_response(inferred.field_map.evaluate(cut.points, 2)))
    is_known = inferred.field_map.knows(cut.points) & np.isfinite(response)
    limits, unit = common_limits(response[is_known]), "uT/m2"
    image = heatmap(
        cut, response, is_known, limits, draw.SPREAD_SCALE, colorbar=draw.colorbar(unit),
        hovertemplate="%{x:.2f}, %{y:.2f} m<br>%{z:.3g} uT/m2<extra></extra>",
    )  # fmt: skip
    near = rows[np.abs(inferred.positions[rows, normal] - cut.height) < inferred.spacing]
    # White with a dark rim, so that they show on any colour.
    marker = {"size": 5, "symbol": "circle", "color": draw.PAPER, "line": {"color": draw.INK, "width": 1.5}}
    marks = draw.flat(cut.along(inferred.positions[near]), marker=marker, name="keypoints", hoverinfo="name+x+y")
    note = f"its cube root; {cut.words}; circles: keypoints within a spacing"
    alt = f"Cube root of det H, cut at {cut.words}, with {len(near)} keypoints."
    figure = cut.figure(f"Determinant of the Hessian of |B|<br><sub>{note}</sub>", [image, marks], alt)
    return figure.update_layout(showlegend=False)


def local_frames_figure(inferred: Inferred, frames: LocalFrames, chosen: Indices | None = None) -> draw.Figure:
    """The field at X* as arrows, and the local frames of chosen keypoints: rows of ``frames``, by default eight."""
    go, some = draw.require_plotly(), draw.thinned(len(inferred), MAX_ARROWS)
    p, b = inferred.positions[some], inferred.field[some]
    chosen = draw.thinned(len(frames), 8) if chosen is None else chosen
    limits = common_limits(draw.magnitude_ut(b))
    # In metres for each uT: the median arrow is two spacings long.
    length = 2 * inferred.spacing / max(float(np.median(draw.magnitude_ut(b))), np.finfo(float).tiny)
    x, y, z = draw.for_display(p).T
    u, v, w = draw.for_display(draw.UT_PER_TESLA * b).T
    arrows = go.Cone(
        x=x, y=y, z=z, u=u, v=v, w=w, sizemode="raw", sizeref=length, colorscale=draw.FIELD_SCALE, cmin=limits[0],
        cmax=limits[1], colorbar=draw.colorbar("uT"), name="field", opacity=0.3,
        hovertemplate="%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>%{u:.1f}, %{v:.1f}, %{w:.1f} uT<extra></extra>",
    )  # fmt: skip
    at, axes, reach = inferred.positions[frames.rows[chosen]], frames.axes[chosen], 3 * inferred.spacing
    traces: list[Any] = [arrows, draw.marks3d(at, "keypoints", draw.INK, draw.BASE_MARKER, 4, showlegend=False)]
    for k, (axis, color) in enumerate(zip("xyz", AXES, strict=True)):
        line = {"color": color, "width": 7}
        ends = draw.between(at, at + reach * axes[:, :, k])
        traces.append(draw.curves3d(ends, name=f"{axis} axes", line=line, showlegend=False))
    n_frames = f"{len(chosen)} of {len(frames)} frames"
    words = f"{len(some)} of {len(inferred)} points of X* drawn; {n_frames}: x red, y green, z blue"
    alt = f"Arrows of the field in space, coloured by magnitude; {words}."
    return draw.new_scene("Field and local frames", traces, words, alt)
