# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a session: paths before and after, closures over the map, and where the graph is weak."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from magmatch.geometry import transform_points
from magmatch.slam.session import Session
from magmatch.typing import Points
from magmatch.viz.figures.ellipsoids import LEVEL
from magmatch.viz.figures.plotting import (
    BASE_COLOR,
    INK,
    LINK_COLOR,
    TARGET_COLOR,
    between,
    coloured_by_field,
    described,
    flat,
    label,
    magnitude_ut,
    new_plane,
    thinned,
)
from magmatch.viz.figures.slices import Cut, common_limits, cut_through, field_on, magnitude_slice

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Nodes along a log whose standard deviation is drawn.
MAX_NODES = 60
# Ellipses drawn in a picture.
MAX_ELLIPSES = 40
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")


def session_figures(session: Session, component: int) -> "list[Figure]":
    """Paths of a component coloured by the field before, and over its map with closures after."""
    logs = session.components[component]
    after = [session.trajectories[k].positions for k in logs]
    before = [transform_points(session.given[k].positions, session.T_map_log(k)) for k in logs]
    field_map = session.map(component)
    cut = cut_through(np.concatenate(after))
    limits = common_limits(magnitude_ut(field_map.survey.field))
    marks = [_line(cut, p, session.names[k], n) for n, (k, p) in enumerate(zip(logs, after, strict=True))]
    marks += _closures(session, cut, set(logs))
    marks += _ellipses(session, cut, logs)
    marks += _fixed_points(session, cut, logs)
    mapped = magnitude_slice(
        "After: |B| of the map",
        cut,
        *field_on(cut, field_map),
        limits,
        marks,
        "; lines: corrected paths, closures (dashed: rejected); ellipses: 95 % of where a node may be",
    )
    return [_before(session, cut, logs, before, limits), mapped]


def weakness_figure(session: Session) -> "Figure":
    """Standard deviation of the position along each log, relative to the first node of its frame."""
    traces, worst = [], 0.0
    for k, path in enumerate(session.paths):
        nodes = path.nodes[thinned(len(path.windows), MAX_NODES)]
        sd = np.array([place for place, _ in session.standard_deviations(nodes)])
        walked = path.walked[path.middles[nodes - path.first_node]]
        worst = max(worst, float(sd.max()))
        line = {"color": (BASE_COLOR, TARGET_COLOR)[k % 2], "width": 2, "dash": DASHES[k // 2 % len(DASHES)]}
        name, marker = label(session.names[k]), {"size": 5}
        traces.append(flat(np.column_stack([walked, sd]), "lines+markers", line=line, marker=marker, name=name))
    figure = new_plane(
        "Where the graph is weak<br><sub>standard deviation of the place against the frame's first node</sub>",
        traces, "path walked (m)", "m", is_equal=False,
    )  # fmt: skip
    figure.update_yaxes(rangemode="tozero")
    return described(figure, f"Standard deviation of the place along each log, at most {worst:.2f} m.")


def _before(
    session: Session, cut: Cut, logs: list[int], before: list[Points], limits: tuple[float, float]
) -> "Figure":
    traces = []
    for k, p in zip(logs, before, strict=True):
        rows = thinned(len(p))
        colors = coloured_by_field(magnitude_ut(session.given[k].field[rows]), limits)
        marker = {"size": 4, "showscale": k == logs[0]} | colors
        traces.append(flat(cut.along(p[rows]), marker=marker, name=label(session.names[k])))
    as_given = "as surveyed" if session.is_rigid else "as odometry has them"
    figure = cut.figure(f"Before: |B| along the paths<br><sub>{as_given}, first poses held</sub>", traces)
    figure.update_layout(showlegend=False)
    return described(figure, f"Paths of {len(logs)} logs {as_given}, coloured by the field's magnitude.")


def _line(cut: Cut, p: Points, name: str, n: int) -> Any:
    style = {"color": INK, "width": 1.2, "dash": DASHES[n % len(DASHES)]}
    return flat(cut.along(p[thinned(len(p))]), "lines", line=style, name=label(name), hoverinfo="name")


def _closures(session: Session, cut: Cut, logs: set[int]) -> list[Any]:
    """Lines between the nodes that closures tie."""
    graph, found = session.graph, []
    for kept, color, dash in ((True, TARGET_COLOR, "solid"), (False, LINK_COLOR, "dash")):
        pairs = [
            (c.first, c.second) for c in graph.closures if c.is_kept == kept and int(graph.log[c.second]) in logs
        ]
        if not pairs:
            continue
        i, j = np.array(pairs).T
        rows = cut.along(between(graph.p[i], graph.p[j]))
        name = "closure" if kept else "rejected closure"
        style = {"color": color, "width": 2.5, "dash": dash}
        marker = {"size": 6, "color": color}
        found.append(flat(rows, "lines+markers", line=style, marker=marker, name=name, hoverinfo="name"))
    return found


def _ellipses(session: Session, cut: Cut, logs: list[int]) -> list[Any]:
    """Draw the places in which nodes along the logs may be, in the plane of the cut: 95 %."""
    axes = list(cut.axes[:2])
    nodes = np.concatenate([session.paths[k].nodes for k in logs])
    nodes = nodes[thinned(len(nodes), MAX_ELLIPSES)]
    angle = np.linspace(0, 2 * np.pi, 33)
    circle = np.sqrt(chi2.ppf(LEVEL, 2)) * np.vstack([np.cos(angle), np.sin(angle)])
    rows = []
    for node, C in zip(nodes, session.covariances_of_place(nodes), strict=True):
        values, directions = np.linalg.eigh(C[np.ix_(axes, axes)])
        rows += [(directions * np.sqrt(values.clip(0))) @ circle + cut.along(session.graph.p[node][None]).T]
        rows += [np.full((2, 1), np.nan)]
    name, line = "95 % of where a node may be", {"color": BASE_COLOR, "width": 1}
    return [flat(np.concatenate(rows, axis=1).T, "lines", line=line, name=name, hoverinfo="name")]


def _fixed_points(session: Session, cut: Cut, logs: list[int]) -> list[Any]:
    """Surveyors' points, and lines to where the logs are now."""
    fixed, graph = session.graph.fixed, session.graph
    if fixed is None or not (rows := np.isin(graph.log[fixed.one], logs)).any():
        return []
    at, off = fixed.position[rows], graph.off_fixed()[rows]
    marker = {"size": [9, 0, 0] * len(at), "color": INK, "symbol": "diamond"}
    style = {"color": INK, "width": 2}
    ends = cut.along(between(at, at + off))
    return [flat(ends, "lines+markers", line=style, marker=marker, name="fixed point")]
