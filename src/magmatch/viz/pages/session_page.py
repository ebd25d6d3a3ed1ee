# SPDX-License-Identifier: BSD-3-Clause
"""The report of slam or merge: the verdict, each log before and after, and where the graph is weak."""

from collections.abc import Callable
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri

from magmatch.geometry import transform_points
from magmatch.number_text import told
from magmatch.slam.result import AnchorResult, ClosureResult, LogResult, SlamResult
from magmatch.slam.session import Session
from magmatch.typing import Points
from magmatch.viz.figures import draw
from magmatch.viz.figures.certainty_figures import LEVEL
from magmatch.viz.figures.slices import Cut, cut_through, field_on, limits_of, magnitude_slice
from magmatch.viz.pages import page
from magmatch.viz.verdict import next_steps

# Nodes along a log whose standard deviation is drawn.
MAX_NODES = 60
# Ellipses drawn in a picture.
MAX_ELLIPSES = 40


def write_session_report(path: str | Path, session: Session, result: SlamResult, command: str) -> None:
    """Write one HTML page about a session; it works offline and on a phone."""
    sections = [_answer(result)]
    for k, logs in enumerate(session.components):
        names = ", ".join(session.names[log] for log in logs)
        sections.append(page.Section(f"Frame {k}: {names}", [page.figure_row(session_figures(session, k))]))
    sections.append(page.Section("Where the graph is weak", [page.figure_row([weakness_figure(session)])]))
    if result.closures:
        sections.append(_closures(result))
    if result.anchors:
        sections.append(_anchors(result))
    words = f"magmatch {result.version}. Same inputs and settings give the same result. Save them as settings.yaml."
    sections.append(page.again("Run it again", words, command, result.config))
    page.write_page(path, "magmatch: " + ", ".join(session.names), sections)


def _answer(result: SlamResult) -> page.Section:
    headline = result.status.replace("_", " ").capitalize()
    logs: dict[str, Callable[[LogResult], str]] = {
        "log": lambda log: log.name,
        "frame": lambda log: str(log.component),
        "path": lambda log: f"{log.length:.1f} m",
        "closures": lambda log: str(log.n_closures),
        "moved (rms)": lambda log: f"{log.moved:.2f} m",
        "end known to": lambda log: f"{log.sd[0]:.2f} m, {degrees(log.sd[1]):.1f} deg",
    }
    verdict = page.verdict(headline, result.reason, is_good=result.is_connected)
    return page.answer(verdict, next_steps(result.status), page.listing(result.logs, logs))


def session_figures(session: Session, component: int) -> list[draw.Figure]:
    """Paths of a component coloured by the field before, and over its map with closures after."""
    logs = session.components[component]
    after = [session.trajectories[k].positions for k in logs]
    before = [transform_points(session.given[k].positions, session.T_map_log(k)) for k in logs]
    field_map = session.map(component)
    cut = cut_through(np.concatenate(after))
    limits = limits_of(field_map)
    marks = [_line(cut, p, session.names[k], n) for n, (k, p) in enumerate(zip(logs, after, strict=True))]
    marks += _drawn_closures(session, cut, logs) + _ellipses(session, cut, logs) + _fixed_points(session, cut, logs)
    mapped = magnitude_slice(
        "After: |B| of the map",
        cut,
        *field_on(cut, field_map),
        limits,
        marks,
        "; lines: corrected paths, closures (dashed: rejected); ellipses: 95 % of where a node may be",
    )
    return [_before(session, cut, logs, before, limits), mapped]


def _line(cut: Cut, p: Points, name: str, n: int) -> Any:
    style = {"color": draw.INK, "width": 1.2, "dash": draw.DASHES[n % len(draw.DASHES)]}
    return draw.flat(cut.along(p[draw.thinned(len(p))]), "lines", line=style, name=draw.label(name), hoverinfo="name")


def _drawn_closures(session: Session, cut: Cut, logs: list[int]) -> list[Any]:
    """Lines between the nodes that closures tie."""
    graph, found = session.graph, []
    for kept, color, dash in ((True, draw.TARGET_COLOR, "solid"), (False, draw.LINK_COLOR, "dash")):
        pairs = [
            (c.first, c.second) for c in graph.closures if c.is_kept == kept and int(graph.log[c.second]) in logs
        ]
        if not pairs:
            continue
        i, j = np.array(pairs).T
        rows = cut.along(draw.between(graph.p[i], graph.p[j]))
        name = "closure" if kept else "rejected closure"
        style = {"color": color, "width": 2.5, "dash": dash}
        marker = {"size": 6, "color": color}
        found.append(draw.flat(rows, "lines+markers", line=style, marker=marker, name=name, hoverinfo="name"))
    return found


def _ellipses(session: Session, cut: Cut, logs: list[int]) -> list[Any]:
    """Draw the places in which nodes along the logs may be, in the plane of the cut: 95 %."""
    axes = list(cut.axes[:2])
    nodes = np.concatenate([session.paths[k].nodes for k in logs])
    nodes = nodes[draw.thinned(len(nodes), MAX_ELLIPSES)]
    angle = np.linspace(0, 2 * np.pi, 33)
    circle = np.sqrt(chdtri(2, 1 - LEVEL)) * np.vstack([np.cos(angle), np.sin(angle)])
    rows = []
    for node, C in zip(nodes, session.covariances_of_place(nodes), strict=True):
        values, directions = np.linalg.eigh(C[np.ix_(axes, axes)])
        rows += [(directions * np.sqrt(values.clip(0))) @ circle + cut.along(session.graph.p[node][None]).T]
        rows += [np.full((2, 1), np.nan)]
    name, line = "95 % of where a node may be", {"color": draw.BASE_COLOR, "width": 1}
    return [draw.flat(np.concatenate(rows, axis=1).T, "lines", line=line, name=name, hoverinfo="name")]


def _fixed_points(session: Session, cut: Cut, logs: list[int]) -> list[Any]:
    """Surveyors' points, and lines to where the logs are now."""
    fixed, graph = session.graph.fixed, session.graph
    if fixed is None or not (rows := np.isin(graph.log[fixed.one], logs)).any():
        return []
    at, off = fixed.position[rows], graph.off_fixed()[rows]
    marker = {"size": [9, 0, 0] * len(at), "color": draw.INK, "symbol": "diamond"}
    style = {"color": draw.INK, "width": 2}
    ends = cut.along(draw.between(at, at + off))
    return [draw.flat(ends, "lines+markers", line=style, marker=marker, name="fixed point")]


def _before(
    session: Session, cut: Cut, logs: list[int], before: list[Points], limits: tuple[float, float]
) -> draw.Figure:
    traces = []
    for k, p in zip(logs, before, strict=True):
        rows = draw.thinned(len(p))
        colors = draw.coloured_by_field(draw.magnitude_ut(session.given[k].field[rows]), limits)
        marker = {"size": 4, "showscale": k == logs[0]} | colors
        traces.append(draw.flat(cut.along(p[rows]), marker=marker, name=draw.label(session.names[k])))
    as_given = "as surveyed" if session.is_rigid else "as odometry has them"
    title = f"Before: |B| along the paths<br><sub>{as_given}, first poses held</sub>"
    alt = f"Paths of {len(logs)} logs {as_given}, coloured by the field's magnitude."
    return cut.figure(title, traces, alt).update_layout(showlegend=False)


def weakness_figure(session: Session) -> draw.Figure:
    """Standard deviation of the position along each log, relative to the first node of its frame."""
    traces, worst = [], 0.0
    for k, path in enumerate(session.paths):
        nodes = path.nodes[draw.thinned(len(path.windows), MAX_NODES)]
        sd = np.array([place for place, _ in session.standard_deviations(nodes)])
        walked = path.walked[path.middles[nodes - path.first_node]]
        worst = max(worst, float(sd.max()))
        color, dash = (draw.BASE_COLOR, draw.TARGET_COLOR)[k % 2], draw.DASHES[k // 2 % len(draw.DASHES)]
        style = {"line": {"color": color, "width": 2, "dash": dash}, "marker": {"size": 5}}
        shown = np.column_stack([walked, sd])
        traces.append(draw.flat(shown, "lines+markers", name=draw.label(session.names[k]), **style))
    figure = draw.new_plane(
        "Where the graph is weak<br><sub>standard deviation of the place against the frame's first node</sub>",
        traces,
        "path walked (m)",
        "m",
        f"Standard deviation of the place along each log, at most {worst:.2f} m.",
        is_equal=False,
    )
    return figure.update_yaxes(rangemode="tozero")


def _closures(result: SlamResult) -> page.Section:
    """Table of the closures, the least certain first."""
    columns: dict[str, Callable[[ClosureResult], str]] = {
        "at": lambda c: f"{c.log_a}, {c.walked_a:.1f} m",
        "and at": lambda c: f"{c.log_b}, {c.walked_b:.1f} m",
        "probability": lambda c: f"{c.probability:.6f}",
        "weight in the graph": lambda c: f"{c.weight:.4f}" if c.weight else "rejected",
    }
    listed = sorted(result.closures, key=lambda c: (c.weight, c.probability))[: page.MAX_LISTED]
    words = f"{len(listed)} of {len(result.closures)}, the least sure first."
    return page.Section("Closures", [page.note(words), page.listing(listed, columns)])


def _anchors(result: SlamResult) -> page.Section:
    """Farthest from where they should be first, in standard deviations."""
    tested = result.tested_anchors()
    columns: dict[str, Callable[[AnchorResult], str]] = {
        "log": lambda a: a.log,
        "at": lambda a: f"{told(a.t)} s",
        "off by": lambda a: f"{np.linalg.norm(a.off):.3f} m",
        "stated sd": lambda a: f"{a.sd:g} m",
        "left out: off by": lambda a: f"{np.linalg.norm(a.off_without):.3f} m" if a in tested else "not known",
        "known there to": lambda a: f"{a.sd_without:.2g} m" if a in tested else "",
    }
    listed = sorted(result.anchors, key=lambda a: -np.linalg.norm(a.off) / a.sd)[: page.MAX_LISTED]
    words = (
        "Largest residual first. A residual far above its standard deviation means a wrong coordinate, time or log. "
        "The path is fitted to these points: how good it is elsewhere shows where a point is left out."
    )
    return page.Section("Fixed points", [page.note(words), page.listing(listed, columns)])
