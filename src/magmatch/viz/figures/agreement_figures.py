# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of how well the base map explains the target: overlap, residuals, and the field along the path."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from magmatch.field.map import FieldMap
from magmatch.typing import Indices, Points, Scalars
from magmatch.viz.figures.plotting import (
    BASE_COLOR,
    FILL,
    INK,
    LINK_COLOR,
    PAPER,
    SHADE,
    SPREAD_SCALE,
    TARGET_COLOR,
    TARGET_MARKER,
    UT_PER_TESLA,
    colorbar,
    described,
    flat,
    for_display,
    new_plane,
    new_scene,
    points3d,
    require_plotly,
)
from magmatch.viz.figures.residuals import LARGEST_ORDINARY, Comparison
from magmatch.viz.figures.slices import Cut, cut_through

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Top of the colour scale of normalised residuals; anything larger is equally wrong.
TOP_RESIDUAL = 4.0
OUTSIDE_STYLE = {"symbol": "x", "color": LINK_COLOR}


def agreement_figures(base_map: FieldMap, compared: Comparison) -> "list[Figure]":
    """Overlap, residuals in space and their distribution."""
    figures = [overlap_figure(base_map, compared)]
    if compared.is_known.any():
        figures += [residual_figure(compared), histogram_figure(compared)]
    return figures


def overlap_figure(base_map: FieldMap, compared: Comparison) -> "Figure":
    """Plan of the known part of the base, and which samples of the target fall into it."""
    cut = cut_through(np.concatenate([base_map.survey.positions, compared.positions]))
    known = base_map.knows(cut.points).reshape(len(cut.second), len(cut.first))
    shade = require_plotly().Heatmap(
        x=for_display(cut.first),
        y=for_display(cut.second),
        z=np.where(known, 1, np.nan).astype(np.float32),
        colorscale=[[0, SHADE], [1, SHADE]],
        showscale=False,
        hoverinfo="skip",
    )
    inside = _seen(cut, compared.positions[compared.is_known], "inside", symbol=TARGET_MARKER, color=TARGET_COLOR)
    outside = _seen(cut, compared.positions[~compared.is_known], "outside", **OUTSIDE_STYLE)
    c, n_inside, n = "xyz"[cut.axes[2]], int(compared.is_known.sum()), len(compared.rows)
    figure = cut.figure(
        f"Overlap: {n_inside} of {n} samples<br><sub>shaded: where the base map knows the "
        f"field at {cut.words}; samples seen along {c}</sub>",
        [shade, inside, outside],
    )
    return described(
        figure,
        f"Plan view along {c}: {n_inside} of {n} samples of the target (diamonds) fall where the base map knows the "
        f"field, {n - n_inside} (crosses) outside.",
    )


def residual_figure(compared: Comparison) -> "Figure":
    """Samples of the target in space, coloured by normalised residual."""
    ordinary = compared.is_known & ~compared.is_large
    scale = {"colorscale": SPREAD_SCALE, "cmin": 0.0, "cmax": TOP_RESIDUAL}
    bar = colorbar("")
    groups = [
        (f"up to {LARGEST_ORDINARY:.1f}", ordinary, {"symbol": "circle", "size": 2.5, "colorbar": bar}),
        ("larger", compared.is_large, {"symbol": "square", "size": 4}),
    ]
    hover = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>%{marker.color:.2f}"
    traces = [
        points3d(
            compared.positions[mask],
            name=name,
            marker={"color": for_display(compared.normalised[mask]), **scale, **style},
            hovertemplate=hover,
        )
        for name, mask, style in groups
    ]
    outside = {**OUTSIDE_STYLE, "size": 2, "opacity": 0.6}
    traces.append(points3d(compared.positions[~compared.is_known], name="outside the base", marker=outside))
    figure = new_scene(
        "Residual at every sample",
        traces,
        "measured minus base map, in standard deviations of both (1 expected on average); base frame",
    )
    n_large, n = int(compared.is_large.sum()), int(compared.is_known.sum())
    return described(
        figure,
        f"Samples of the target in the base frame, coloured by normalised residual: root mean square "
        f"{compared.rms:.2f}; {n_large} of {n} in the overlap (squares) exceed {LARGEST_ORDINARY:.1f}; "
        "1 in 1000 would by chance.",
    )


def histogram_figure(compared: Comparison) -> "Figure":
    """Distribution of the residuals, and the distribution expected if model and noise explain all."""
    values = np.minimum(compared.normalised[compared.is_known], TOP_RESIDUAL)
    edges = np.linspace(0, TOP_RESIDUAL, 33)
    share = np.histogram(values, edges)[0] / len(values)
    # The squared norm of three standard normal components is chi-square with three degrees of freedom.
    expected = np.diff(chi2.cdf(3 * edges**2, 3))
    middle = (edges[1:] + edges[:-1]) / 2
    go = require_plotly()
    bars = go.Bar(x=middle, y=share, name="measured", marker={"color": FILL, "line": {"color": INK, "width": 0.5}})
    line = go.Scatter(
        x=middle, y=expected, name="expected", mode="lines", line={"color": INK, "dash": "dash", "width": 2}
    )
    figure = new_plane(
        f"Distribution of the residuals<br><sub>the last bar holds everything above {TOP_RESIDUAL:.0f}</sub>",
        [bars, line], "normalised residual", "share of samples", is_equal=False,
    )  # fmt: skip
    figure.update_layout(bargap=0.05)
    return described(
        figure,
        f"Histogram of normalised residuals: median {np.median(values):.2f}, where "
        f"{np.sqrt(chi2.median(3) / 3):.2f} is expected if model and noise explain all.",
    )


def along_figure(compared: Comparison) -> "Figure":
    """Field components along the target: measured, and predicted by the base map."""
    from plotly.subplots import make_subplots

    go, known = require_plotly(), compared.is_known
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    plane = new_plane(
        "Field along the target, in the base frame<br><sub>band: two standard deviations of the base map; gaps: "
        "outside the base</sub>", [], "", "", is_equal=False,
    )  # fmt: skip
    figure.update_layout(plane.layout)
    measured, expected = (UT_PER_TESLA * b for b in (compared.measured, compared.expected))
    sd = UT_PER_TESLA * compared.expected_sd
    x = for_display(compared.rows)
    for k in range(3):
        said = np.where(known, expected[:, k], np.nan)
        across, up = _band(compared.rows, said - 2 * sd[:, k], said + 2 * sd[:, k])
        styles: list[tuple[Any, Any, dict[str, Any]]] = [
            (across, up, {"line": {"width": 0}, "fill": "toself", "fillcolor": SHADE, "showlegend": False}),
            (x, said, {"name": "base map", "line": {"color": BASE_COLOR, "dash": "dash", "width": 2.5}}),
            (x, measured[:, k], {"name": "measured", "line": {"color": TARGET_COLOR, "width": 1}}),
        ]
        for along, values, style in styles:
            drawn = {"mode": "lines", "hoverinfo": "skip", "showlegend": k == 0} | style
            figure.add_trace(go.Scatter(x=along, y=for_display(values), **drawn), row=k + 1, col=1)
        # Where the map ends, the band is many times as wide as the field: it may leave the panel, the lines may not.
        lines = np.concatenate([measured[:, k], said[known]])
        margin = 0.1 * np.ptp(lines)
        figure.update_yaxes(
            title_text=f"b{'xyz'[k]} (uT)", gridcolor=PAPER, zeroline=False,
            range=[lines.min() - margin, lines.max() + margin], row=k + 1, col=1,
        )  # fmt: skip
    figure.update_xaxes(title_text="sample", gridcolor=PAPER, zeroline=False, row=3, col=1)
    figure.update_layout(height=480)
    rms = float(np.sqrt(((measured - expected)[known] ** 2).sum(axis=1).mean()))
    return described(
        figure,
        f"Three panels, bx, by and bz over the target's samples: measured (line) and from the base map (dashes) "
        f"differ by {rms:.3g} uT root mean square in the overlap.",
    )


def _band(rows: Indices, low: Scalars, high: Scalars) -> tuple[Scalars, Scalars]:
    """Outline of a band over rows, one closed piece for each run in which none is NaN."""
    known = np.flatnonzero(np.isfinite(low))
    runs = np.split(known, np.flatnonzero(np.diff(known) > 1) + 1)
    x = [np.concatenate([rows[run], rows[run][::-1], [np.nan]]) for run in runs]
    y = [np.concatenate([low[run], high[run][::-1], [np.nan]]) for run in runs]
    return np.concatenate(x), np.concatenate(y)


def _seen(cut: Cut, p: Points, name: str, **marker: Any) -> Any:
    """Points of the base frame on the plan."""
    return flat(cut.along(p), name=name, marker={"size": 4, "opacity": 0.7, **marker}, hoverinfo="x+y+name")
