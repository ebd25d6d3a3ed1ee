# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a log in a map: the stated path over the field, and its probability."""

from typing import TYPE_CHECKING

import numpy as np

from magmatch.geometry import path_walked
from magmatch.localization.result import LocalizationResult
from magmatch.localization.track import Track
from magmatch.viz.figures.plotting import colorbar, described, flat, for_display, magnitude_ut, new_plane
from magmatch.viz.figures.slices import common_limits, cut_through, field_on, magnitude_slice

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def path_figure(track: Track, k: int) -> "Figure":
    """The poses stated in one of the maps, over its |B|."""
    field_map = track.maps[k]
    stated = [e for e in track.estimates if e.is_stated and (len(track.maps) == 1 or e.map == _name(track, k))]
    points = np.array([e.matrix[:3, 3] for e in stated if e.matrix is not None]).reshape(-1, 3)
    sd = np.array([np.sqrt(np.linalg.eigvalsh(e.covariance[3:, 3:])[-1]) for e in stated if e.covariance is not None])
    cut = cut_through(np.concatenate([field_map.survey.positions, points]))
    marker = {
        "size": 4,
        "color": for_display(sd),
        "colorscale": "Bluered",
        # Above the picture; the field's is below.
        "colorbar": colorbar("m")
        | {"len": 0.6, "x": 0.3, "yref": "paper", "y": 1.0, "thickness": 8, "nticks": 3, "tickangle": 0},
    }
    path = flat(cut.along(points), marker=marker, name="path")
    limits = common_limits(magnitude_ut(field_map.survey.field))
    return magnitude_slice(
        "|B| of the map", cut, *field_on(cut, field_map), limits, [path], "; points: stated poses, coloured by sd"
    )


def status_figure(track: Track) -> "Figure":
    """Probability of the best place along the path, and where a pose was accurate enough to be stated."""
    walked = path_walked(track.log.positions)
    shown, traces = np.column_stack([walked, [e.probability for e in track.estimates]]), []
    for phase in dict.fromkeys(e.phase for e in track.estimates):
        rows = np.array([e.phase == phase for e in track.estimates])
        traces.append(flat(shown[rows], marker={"size": 4}, name=phase))
    figure = new_plane("How sure the place was", traces, "path walked (m)", "probability", is_equal=False)
    figure.update_yaxes(range=[0, 1.02])
    return described(
        figure, f"Probability that the best place is right; a pose for {track.is_stated.mean():.0%} of the samples."
    )


def sd_figure(result: LocalizationResult) -> "Figure":
    """How accurate the stated poses are, along the log."""
    t, shift, _ = np.array(result.sd).reshape(-1, 3).T
    trace = flat(np.column_stack([t, shift]), marker={"size": 4}, name="sd")
    figure = new_plane("How accurate the pose was", [trace], "t (s)", "sd in the worst direction (m)", is_equal=False)
    return described(figure, f"Standard deviation of the stated poses over time: {result.share_in_words}.")


def _name(track: Track, k: int) -> str:
    names = dict.fromkeys(e.map for e in track.estimates if e.map is not None)
    return sorted(names)[k]
