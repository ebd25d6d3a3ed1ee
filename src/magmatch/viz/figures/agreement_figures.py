# SPDX-License-Identifier: BSD-3-Clause
"""How well the base map explains the target under a pose: samples against it, overlap, residuals, the path."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtr, chdtri

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Indices, Mask, Points, Scalars, Vectors
from magmatch.viz.figures import draw
from magmatch.viz.figures.draw import thinned
from magmatch.viz.figures.slices import Cut, cut_through, heatmap, map_in

# Normalised residual beyond which a sample is marked: of right ones, about 1 in 1000 (chi-square, three degrees).
LARGEST_ORDINARY = 2.33
MAX_COMPARED = 3000
# Top of the colour scale of normalised residuals; anything larger is equally wrong.
TOP_RESIDUAL = 4.0
OUTSIDE_STYLE = {"symbol": "x", "color": draw.LINK_COLOR}


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Samples of the target against the base map; arrays in the base's frame."""

    rows: Indices  # (n,): which samples of the target these are
    positions: Points  # (n, 3), m
    # (n, 3), T: the target's vectors, turned, and corrected for the sensor where that was estimated
    measured: Vectors
    expected: Vectors  # (n, 3), T: the base map's prediction there, and its standard deviation
    expected_sd: Vectors  # (n, 3), T
    # (n,): length of the residual in its standard deviations: rms over samples is 1 where model and noise explain all
    normalised: Scalars
    is_known: Mask  # (n,): where the base map knows the field; nothing is said of the others

    @property
    def overlap(self) -> float:
        """Share of the samples in the known part of the base."""
        return float(self.is_known.mean())

    @property
    def typical(self) -> float | None:
        """Robust root mean square, from the median, as a result's ``residual`` is; None where nothing overlaps."""
        values = self.normalised[self.is_known]
        return float(np.median(values) / np.sqrt(chdtri(3, 0.5) / 3)) if len(values) else None

    @property
    def rms(self) -> float | None:
        """Root mean square of the normalised residual over the overlap, where bad samples count in full; or None."""
        values = self.normalised[self.is_known]
        return float(np.sqrt((values**2).mean())) if len(values) else None

    @property
    def is_large(self) -> Mask:
        """Samples in the overlap that differ by more than chance allows."""
        return np.asarray(self.is_known & (self.normalised > LARGEST_ORDINARY))


def compare(
    base: FieldMap,
    target: Survey | FieldMap,
    T_base_target: RigidTransform,
    result: RegistrationResult,
    n_compared: int = MAX_COMPARED,
) -> Comparison:
    """Put the target's samples into the base map."""
    survey = survey_of(target)
    variance = sum(m.hyperparameters.noise_sd**2 for m in (base, map_in(target) or base))
    rows = thinned(len(survey), n_compared)
    p_base = transform_points(survey.positions[rows], T_base_target)
    measured = rotate_vectors(corrected(survey.field[rows], result), T_base_target)
    expected, spread = base.evaluate(p_base).field, base.covariance(p_base)
    r = measured - expected
    whitened = np.linalg.solve(spread + variance * np.eye(3), r[..., None])[..., 0]
    return Comparison(
        rows=rows,
        positions=p_base,
        measured=measured,
        expected=expected,
        expected_sd=np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0)),
        normalised=np.sqrt(np.maximum((r * whitened).sum(axis=1), 0) / 3),
        is_known=base.knows(p_base),
    )


def corrected(field: Vectors, result: RegistrationResult) -> Vectors:
    """Readings of the target as the base's sensor would give them, as far as the result says how they differ."""
    sensor = result.sensor or {}
    bias = np.asarray(sensor.get("bias") or np.zeros(3), dtype=np.float64)
    gain = np.asarray(sensor.get("gain") or (sensor.get("scale") or 1.0) * np.eye(3), dtype=np.float64)
    return np.asarray(np.linalg.solve(gain, (field - bias).T).T)


def agreement_figures(base_map: FieldMap, compared: Comparison) -> list[draw.Figure]:
    """Overlap, residuals in space and their distribution."""
    figures = [overlap_figure(base_map, compared)]
    if compared.is_known.any():
        figures += [residual_figure(compared), histogram_figure(compared)]
    return figures


def overlap_figure(base_map: FieldMap, compared: Comparison) -> draw.Figure:
    """Plan of the known part of the base, and which samples of the target fall into it."""
    cut = cut_through(np.concatenate([base_map.survey.positions, compared.positions]))
    known = base_map.knows(cut.points)
    bare = {"showscale": False, "hoverinfo": "skip", "hovertemplate": None}
    shade = heatmap(cut, np.ones(len(known)), known, (0.0, 1.0), [[0, draw.SHADE], [1, draw.SHADE]], **bare)
    inside = _seen(
        cut, compared.positions[compared.is_known], "inside", symbol=draw.TARGET_MARKER, color=draw.TARGET_COLOR
    )
    outside = _seen(cut, compared.positions[~compared.is_known], "outside", **OUTSIDE_STYLE)
    c, n_inside, n = "xyz"[cut.axes[2]], int(compared.is_known.sum()), len(compared.rows)
    return cut.figure(
        f"Overlap: {n_inside} of {n} samples<br><sub>shaded: where the base map knows the "
        f"field at {cut.words}; samples seen along {c}</sub>",
        [shade, inside, outside],
        f"Plan view along {c}: {n_inside} of {n} samples of the target (diamonds) fall where the base map knows the "
        f"field, {n - n_inside} (crosses) outside.",
    )


def residual_figure(compared: Comparison) -> draw.Figure:
    """Samples of the target in space, coloured by normalised residual."""
    ordinary = compared.is_known & ~compared.is_large
    scale = {"colorscale": draw.SPREAD_SCALE, "cmin": 0.0, "cmax": TOP_RESIDUAL}
    bar = draw.colorbar("")
    groups = [
        (f"up to {LARGEST_ORDINARY:.1f}", ordinary, {"symbol": "circle", "size": 2.5, "colorbar": bar}),
        ("larger", compared.is_large, {"symbol": "square", "size": 4}),
    ]
    hover = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>%{marker.color:.2f}"
    traces = [
        draw.points3d(
            compared.positions[mask],
            name=name,
            marker={"color": draw.for_display(compared.normalised[mask]), **scale, **style},
            hovertemplate=hover,
        )
        for name, mask, style in groups
    ]
    outside = {**OUTSIDE_STYLE, "size": 2, "opacity": 0.6}
    traces.append(draw.points3d(compared.positions[~compared.is_known], name="outside the base", marker=outside))
    n_large, n = int(compared.is_large.sum()), int(compared.is_known.sum())
    return draw.new_scene(
        "Residual at every sample",
        traces,
        "measured minus base map, in standard deviations of both (1 expected on average); base frame",
        f"Samples of the target in the base frame, coloured by normalised residual: root mean square "
        f"{compared.rms:.2f}; {n_large} of {n} in the overlap (squares) exceed {LARGEST_ORDINARY:.1f}; "
        "1 in 1000 would by chance.",
    )


def histogram_figure(compared: Comparison) -> draw.Figure:
    """Distribution of the residuals, and the distribution expected if model and noise explain all."""
    values = np.minimum(compared.normalised[compared.is_known], TOP_RESIDUAL)
    edges = np.linspace(0, TOP_RESIDUAL, 33)
    share = np.histogram(values, edges)[0] / len(values)
    # The squared norm of three standard normal components is chi-square with three degrees of freedom.
    expected = np.diff(chdtr(3, 3 * edges**2))
    middle = (edges[1:] + edges[:-1]) / 2
    go = draw.require_plotly()
    bars = go.Bar(
        x=middle, y=share, name="measured", marker={"color": draw.FILL, "line": {"color": draw.INK, "width": 0.5}}
    )
    line = go.Scatter(
        x=middle, y=expected, name="expected", mode="lines", line={"color": draw.INK, "dash": "dash", "width": 2}
    )
    figure = draw.new_plane(
        f"Distribution of the residuals<br><sub>the last bar holds everything above {TOP_RESIDUAL:.0f}</sub>",
        [bars, line],
        "normalised residual",
        "share of samples",
        f"Histogram of normalised residuals: median {np.median(values):.2f}, where "
        f"{np.sqrt(chdtri(3, 0.5) / 3):.2f} is expected if model and noise explain all.",
        is_equal=False,
    )
    return figure.update_layout(bargap=0.05)


def along_figure(compared: Comparison) -> draw.Figure:
    """Field components along the target: measured, and predicted by the base map."""
    from plotly.subplots import make_subplots

    go, known = draw.require_plotly(), compared.is_known
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    plane = draw.new_plane(
        "Field along the target, in the base frame<br><sub>band: two standard deviations of the base map; gaps: "
        "outside the base</sub>", [], "", "", is_equal=False,
    )  # fmt: skip
    figure.update_layout(plane.layout)
    measured, expected = (draw.UT_PER_TESLA * b for b in (compared.measured, compared.expected))
    sd = draw.UT_PER_TESLA * compared.expected_sd
    x = draw.for_display(compared.rows)
    for k in range(3):
        said = np.where(known, expected[:, k], np.nan)
        across, up = _band(compared.rows, said - 2 * sd[:, k], said + 2 * sd[:, k])
        styles: list[tuple[Any, Any, dict[str, Any]]] = [
            (across, up, {"line": {"width": 0}, "fill": "toself", "fillcolor": draw.SHADE, "showlegend": False}),
            (x, said, {"name": "base map", "line": {"color": draw.BASE_COLOR, "dash": "dash", "width": 2.5}}),
            (x, measured[:, k], {"name": "measured", "line": {"color": draw.TARGET_COLOR, "width": 1}}),
        ]
        for along, values, style in styles:
            drawn = {"mode": "lines", "hoverinfo": "skip", "showlegend": k == 0} | style
            figure.add_trace(go.Scatter(x=along, y=draw.for_display(values), **drawn), row=k + 1, col=1)
        # Where the map ends, the band is many times as wide as the field: it may leave the panel, the lines may not.
        lines = np.concatenate([measured[:, k], said[known]])
        margin = 0.1 * np.ptp(lines)
        figure.update_yaxes(
            title_text=f"b{'xyz'[k]} (uT)", gridcolor=draw.PAPER, zeroline=False,
            range=[lines.min() - margin, lines.max() + margin], row=k + 1, col=1,
        )  # fmt: skip
    figure.update_xaxes(title_text="sample", gridcolor=draw.PAPER, zeroline=False, row=3, col=1)
    figure.update_layout(height=480)
    rms = float(np.sqrt(((measured - expected)[known] ** 2).sum(axis=1).mean()))
    return draw.described(
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
    return draw.flat(cut.along(p), name=name, marker={"size": 4, "opacity": 0.7, **marker}, hoverinfo="x+y+name")
