# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of one map: the field on cuts, its standard deviation, and the comparison of priors."""

from typing import TYPE_CHECKING

import numpy as np

from magmatch.field.map import FieldMap
from magmatch.typing import Scalars
from magmatch.viz.figures.coverage import Coverage
from magmatch.viz.figures.plotting import (
    BASE_COLOR,
    FIELD_SCALE,
    INK,
    PAPER,
    SPREAD_SCALE,
    UT_PER_TESLA,
    described,
    flat,
    label,
    magnitude_ut,
    new_plane,
    require_plotly,
)
from magmatch.viz.figures.slices import (
    Cut,
    common_limits,
    cut_normal_to,
    cut_through,
    field_on,
    magnitude_slice,
    slice_figure,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# A box at least this thick, in its longest side, is cut along all three axes.
THICK = 0.15
# Samples marked on a cut, those nearest to it.
MAX_MARKED = 400


def field_figures(field_map: FieldMap) -> "list[Figure]":
    """Magnitude on every cut worth drawing, and the three components on the main one."""
    p, limits = field_map.survey.positions, common_limits(magnitude_ut(field_map.survey.field))
    main = cut_through(p)
    field, is_known = field_on(main, field_map)
    name = label(field_map.survey.name)
    figures = [magnitude_slice(f"{name}: |B|, posterior mean", main, field, is_known, limits)]
    for k, axis in enumerate("xyz"):
        values = UT_PER_TESLA * field[:, k]
        range_k = common_limits(UT_PER_TESLA * field_map.survey.field[:, k])
        figures.append(slice_figure(f"B{axis}", main, values, is_known, range_k, FIELD_SCALE))
    size = np.ptp(p, axis=0)
    for normal in main.axes[:2] if size.min() >= THICK * size.max() else ():
        cut = cut_normal_to(p, normal)
        figures.append(magnitude_slice("|B|, across", cut, *field_on(cut, field_map), limits))
    return figures


def spread_figure(field_map: FieldMap, cut: Cut, sd: Scalars) -> "Figure":
    """Standard deviation of a component on a cut, with the samples nearest to it."""
    p = field_map.survey.positions
    sd, is_known = UT_PER_TESLA * sd, field_map.knows(cut.points)
    nearest = np.argsort(np.abs(p[:, cut.axes[2]] - cut.height), kind="stable")[:MAX_MARKED]
    circles = {"size": 3, "color": PAPER, "line": {"color": INK, "width": 0.7}}
    marks = flat(cut.along(p[nearest]), marker=circles, name="samples", hoverinfo="skip")
    limits = common_limits(sd[is_known])
    note = f"; circles: the {len(nearest)} samples nearest to the cut"
    return slice_figure("Standard deviation of a component", cut, sd, is_known, limits, SPREAD_SCALE, [marks], note)


def coverage_figure(coverage: Coverage) -> "Figure":
    """Cumulative distribution of the standard deviation over the known part."""
    sd = UT_PER_TESLA * coverage.sd[np.linspace(0, len(coverage.sd) - 1, min(len(coverage.sd), 300)).astype(int)]
    share = np.linspace(0, 1, len(sd))
    line = {"color": BASE_COLOR, "width": 2.5}
    curve = flat(np.column_stack([sd, share]), "lines", line=line, showlegend=False)
    figure = new_plane(
        "Uncertainty over the known part<br><sub>share of the known volume with a smaller standard deviation</sub>",
        [curve], "standard deviation of a component (uT)", "share", is_equal=False,
    )  # fmt: skip
    figure.update_yaxes(range=[0, 1.02])
    median = coverage.quantile(0.5) or 0.0
    return described(
        figure,
        f"Curve of the share of the known part by standard deviation: half is below {UT_PER_TESLA * median:.3g} uT.",
    )


def comparison_figure(errors: dict[str, float], taken: str) -> "Figure":
    """Error on held-out data by prior: bars, the chosen one filled, the others hatched."""
    names = sorted(errors, key=lambda name: errors[name])
    values: Scalars = UT_PER_TESLA * np.array([errors[name] for name in names])
    bars = require_plotly().Bar(
        x=values, y=[f"{name} (chosen)" if name == taken else name for name in names], orientation="h",
        text=[f"{v:.3g} uT" for v in values], textposition="outside", cliponaxis=False, hoverinfo="skip",
        marker={"color": BASE_COLOR, "pattern": {"shape": ["" if name == taken else "/" for name in names]}},
        showlegend=False,
    )  # fmt: skip
    figure = new_plane(
        "Priors compared<br><sub>typical error on held-out data, as 3-vectors, noise included</sub>",
        [bars], "error (uT)", "", is_equal=False,
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(range=[0, 1.3 * float(values.max())])
    figure.update_layout(height=130 + 40 * len(names))
    told = ", ".join(f"{name} {v:.3g} uT" for name, v in zip(names, values, strict=True))
    return described(figure, f"Bars of the typical error on held-out data by prior: {told}. Chosen: {taken}.")
