# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a log in a map: the stated path over the field, and its probability."""

from typing import TYPE_CHECKING

import numpy as np

from magmatch.geometry import path_walked
from magmatch.localization.track import Track
from magmatch.viz.figures.plotting import colorbar, described, for_display, magnitude_ut, new_plane, require_plotly
from magmatch.viz.figures.slices import common_limits, cut_through, field_on, magnitude_slice

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def path_figure(track: Track, k: int) -> "Figure":
    """The poses stated in one of the maps, over its |B|."""
    go, field_map = require_plotly(), track.maps[k]
    stated = [e for e in track.estimates if e.is_stated and (len(track.maps) == 1 or e.map == _name(track, k))]
    points = np.array([e.matrix[:3, 3] for e in stated if e.matrix is not None]).reshape(-1, 3)
    sd = np.array([np.sqrt(np.linalg.eigvalsh(e.covariance[3:, 3:])[-1]) for e in stated if e.covariance is not None])
    cut = cut_through(np.concatenate([field_map.survey.positions, points]))
    a, b, _ = cut.axes
    marker = {
        "size": 4,
        "color": for_display(sd),
        "colorscale": "Bluered",
        # Above the picture; the field's is below.
        "colorbar": colorbar("m")
        | {"len": 0.6, "x": 0.3, "yref": "paper", "y": 1.0, "thickness": 8, "nticks": 3, "tickangle": 0},
    }
    path = go.Scatter(
        x=for_display(points[:, a]), y=for_display(points[:, b]), mode="markers", marker=marker, name="path"
    )
    limits = common_limits(magnitude_ut(field_map.survey.field))
    return magnitude_slice(
        "|B| of the map", cut, *field_on(cut, field_map), limits, [path], "; points: stated poses, coloured by sd"
    )


def status_figure(track: Track) -> "Figure":
    """Probability of the best hypothesis along the path, and where a pose was stated."""
    go, walked = require_plotly(), path_walked(track.log.positions)
    probability = np.array([e.probability for e in track.estimates])
    traces = []
    for status in dict.fromkeys(e.status for e in track.estimates):
        rows = np.array([e.status is status for e in track.estimates])
        traces.append(
            go.Scatter(
                x=for_display(walked[rows]), y=for_display(probability[rows]), mode="markers", marker={"size": 4},
                name=status.replace("_", " "),
            )
        )  # fmt: skip
    figure = new_plane("How sure it was", traces, "path walked (m)", "probability", is_equal=False)
    figure.update_yaxes(range=[0, 1.02])
    return described(
        figure, f"Probability of the best hypothesis; a pose for {track.is_stated.mean():.0%} of the samples."
    )


def _name(track: Track, k: int) -> str:
    names = dict.fromkeys(e.map for e in track.estimates if e.map is not None)
    return sorted(names)[k]
