# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of one survey."""

import numpy as np

from magmatch.data.survey import Survey
from magmatch.viz.figures import draw
from magmatch.viz.figures.slices import common_limits


def survey_figure(survey: Survey, left_out: Survey | None = None) -> draw.Figure:
    """Samples in space, coloured by field magnitude."""
    rows = draw.thinned(len(survey))
    magnitude = draw.magnitude_ut(survey.field[rows])
    low, high = common_limits(magnitude)
    marker = {"size": 3 if len(rows) < 1000 else 2, "symbol": draw.BASE_MARKER} | draw.coloured_by_field(
        magnitude, (low, high)
    )
    hover = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<br>|B| %{marker.color:.2f} uT<extra></extra>"
    traces = [draw.points3d(survey.positions[rows], marker=marker, hovertemplate=hover, showlegend=False)]
    if left_out is not None and len(left_out):
        cross = {"symbol": "x", "size": 4, "color": draw.TARGET_COLOR}
        traces.append(draw.points3d(left_out.positions, name="left out", marker=cross, showlegend=True))
    shown = "" if len(rows) == len(survey) else f" ({len(rows)} drawn)"
    extent = " by ".join(f"{side:.3g}" for side in np.ptp(survey.positions, axis=0))
    return draw.new_scene(
        f"{draw.label(survey.name)}: {len(survey)} samples{shown}",
        traces,
        f"frame '{survey.frame}', metres",
        f"{len(survey)} samples of {survey.name} in space, over {extent} m, coloured by field magnitude: most lie "
        f"between {low:.3g} and {high:.3g} uT.",
    )


def profile_figure(survey: Survey) -> draw.Figure:
    """Field components along the survey: over time, or over sample number where there is none."""
    rows = draw.thinned(len(survey), 3000)
    along = rows if survey.times is None else survey.times[rows] - survey.times[0]
    field = draw.UT_PER_TESLA * survey.field[rows]
    drawn = [*zip(("bx", "by", "bz"), field.T, strict=True), ("|B|", np.linalg.norm(field, axis=1))]
    colors = (draw.BASE_COLOR, draw.TARGET_COLOR, draw.LINK_COLOR, draw.INK)
    traces = [
        draw.flat(np.column_stack([along, values]), "lines", name=name, line={"color": color, "dash": dash})
        for (name, values), color, dash in zip(drawn, colors, draw.DASHES[:4], strict=True)
    ]
    spans = ", ".join(f"{name} from {values.min():.3g} to {values.max():.3g}" for name, values in drawn)
    return draw.new_plane(
        f"{draw.label(survey.name)}: field along the survey",
        traces,
        "sample" if survey.times is None else "time since the first sample (s)",
        "field, survey frame (uT)",
        f"Field of {survey.name} along the survey, uT: {spans}.",
        is_equal=False,
    )
