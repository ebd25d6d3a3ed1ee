# SPDX-License-Identifier: BSD-3-Clause
"""Figures of an evaluation: the spread of errors by experiment, and curves of success and error over a condition."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from magmatch.viz.figures.draw import described, new_plane, require_plotly
from magmatch_evaluation.experiments import Experiment
from magmatch_evaluation.rows import AnyRow, Row
from magmatch_evaluation.statistics import Summaries

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Dark to light, so that grey print tells them apart too; marker and dash differ as well.
STYLES: dict[str, tuple[str, str, str]] = {
    "default": ("#00365F", "circle", "solid"),
    "paper": ("#D55E00", "diamond", "dash"),
    "sift": ("#57606A", "square", "dot"),
    "sift-best": ("#8A5A9E", "cross", "dashdot"),
    "kiss": ("#00795A", "x", "longdash"),
    "gicp": ("#B8860B", "triangle-up", "longdashdot"),
    "refine-rough": ("#3F7FBF", "triangle-down", "dash"),
    "refine-identity": ("#B0302F", "star", "dot"),
}
UNKNOWN = ("#57606A", "circle-open", "solid")


def error_figure(experiment: Experiment, rows: Sequence[AnyRow]) -> "Figure":
    """Draw the cumulative share of trials over the error of the best pose, method by method, of one experiment.

    A curve that ends below one has trials without a pose.
    """
    traces = []
    for method in experiment.methods:
        own = [r for r in rows if isinstance(r, Row) and (r.experiment, r.method) == (experiment.name, method)]
        errors = np.sort([r.distance for r in own])
        if not len(errors):
            continue
        share = np.arange(1, len(errors) + 1) / len(errors)
        has_pose = np.isfinite(errors)
        x = 1e3 * np.maximum(errors[has_pose], 1e-6)
        traces.append(_line(method, x, share[has_pose], shape="hv", size=6))
    title = (
        f"{experiment.name}<br><sub>{experiment.title}; share of trials whose best pose is at most so far off</sub>"
    )
    figure = new_plane(title, traces, "translation error (mm)", "share of trials", is_equal=False)
    figure.update_xaxes(type="log", dtick=1)
    figure.update_yaxes(range=[0, 1.03])
    figure.add_vline(x=1e3 * experiment.tolerance.distance, line={"color": "#57606A", "width": 1, "dash": "dot"})
    return described(figure, f"Cumulative translation error of each method in {experiment.name}.")


def curve_figures(what: str, axis: str, experiments: Sequence[Experiment], found: Summaries) -> "list[Figure]":
    """Draw success with its 95 % intervals, and the median error of all trials, over one condition.

    The experiments are the points of the curves; the error has a gap where most trials have no pose.
    """
    success, error = [], []
    for method in dict.fromkeys(m for e in experiments for m in e.methods):
        points = [(e.value, found[e.name, method]) for e in experiments if (e.name, method) in found]
        if not points:
            continue
        x = [value for value, _ in points]
        rate = np.array([s.n_right / s.n for _, s in points])
        low, high = np.array([s.success for _, s in points]).T
        bars = {"type": "data", "array": high - rate, "arrayminus": rate - low, "thickness": 1, "width": 3}
        median = [1e3 * s.distance.median if math.isfinite(s.distance.median) else None for _, s in points]
        success.append(_line(method, x, rate, error_y=bars))
        error.append(_line(method, x, median))
    title = f"{what}: success<br><sub>accepted and right, 95 % intervals</sub>"
    one = new_plane(title, success, axis, "share of trials", is_equal=False)
    one.update_yaxes(range=[-0.03, 1.05])
    title = f"{what}: error<br><sub>median over all trials of the best pose</sub>"
    two = new_plane(title, error, axis, "translation error (mm)", is_equal=False)
    two.update_yaxes(type="log", dtick=1)
    return [
        described(one, f"Share of right answers of each method over {axis}."),
        described(two, f"Median translation error of each method over {axis}."),
    ]


def _line(method: str, x: Any, y: Any, *, shape: str = "linear", size: int = 8, **more: Any) -> Any:
    color, symbol, dash = STYLES.get(method, UNKNOWN)
    return require_plotly().Scatter(
        x=x, y=y, name=method, mode="lines+markers", line={"color": color, "dash": dash, "shape": shape},
        marker={"symbol": symbol, "size": size}, **more,
    )  # fmt: skip
