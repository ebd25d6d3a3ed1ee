# SPDX-License-Identifier: BSD-3-Clause
"""The report of `localize`: the verdict, the path over the map, and where it was lost and why."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from magmatch.geometry import path_walked
from magmatch.localization.result import LocalizationResult, LocalizationStatus, Segment
from magmatch.localization.track import Track
from magmatch.viz.figures import draw
from magmatch.viz.figures.slices import cut_through, field_on, limits_of, magnitude_slice
from magmatch.viz.pages import page
from magmatch.viz.verdict import next_steps


def write_track_report(path: str | Path, track: Track, result: LocalizationResult) -> None:
    """Write one HTML page about a log in a map; it works offline and on a phone."""
    sections = [page.answer(verdict_on(result), steps_after(result))]
    sections += [
        page.Section(f"In {_name(track, k)}", [page.figure_row([path_figure(track, k)])])
        for k in range(len(track.maps))
    ]
    columns: dict[str, Callable[[Segment], str]] = {
        "from (s)": lambda s: f"{s.t0:.2f}",
        "for": lambda s: f"{s.t1 - s.t0:.1f} s",
        "phase": lambda s: s.phase,
        "map": lambda s: s.map or "",
        "why": lambda s: s.why,
    }
    longest = sorted(result.segments, key=lambda s: s.t0 - s.t1)[: page.MAX_LISTED]
    parts = page.listing(sorted(longest, key=lambda s: s.t0), columns)
    figures = [status_figure(track), *([sd_figure(result)] if result.sd else [])]
    sections.append(page.Section("Along the log", [page.figure_row(figures), parts]))
    sections.append(page.again("Run it again", "", None, result.config))
    page.write_page(path, f"magmatch: {track.log.name}", sections)


def verdict_on(result: LocalizationResult) -> str:
    """Say where the log ended, and for how much of it a pose is stated; good news only if it ended localized."""
    words = {LocalizationStatus.LOST: "Lost at the end", LocalizationStatus.NEVER: "Never localized"}
    ended = words.get(result.status, result.status.capitalize())
    ended = "Pose too uncertain at the end" if result.is_place_known else ended
    share = f"; {result.share_in_words}" if result.is_localized else ""
    return page.verdict(f"{ended}{share}", result.reason, is_good=result.status is LocalizationStatus.LOCALIZED)


def steps_after(result: LocalizationResult) -> list[str]:
    """What the user can do; where the place is known at the end and the pose is not, nothing was lost."""
    return next_steps("uncertain" if result.is_place_known else result.status)


def path_figure(track: Track, k: int) -> draw.Figure:
    """The poses stated in one of the maps, over its |B|."""
    field_map = track.maps[k]
    name = _name(track, k)
    stated = [e for e in track.estimates if e.is_stated and (len(track.maps) == 1 or e.map == name)]
    points = np.array([e.matrix[:3, 3] for e in stated if e.matrix is not None]).reshape(-1, 3)
    sd = np.array([np.sqrt(np.linalg.eigvalsh(e.covariance[3:, 3:])[-1]) for e in stated if e.covariance is not None])
    cut = cut_through(np.concatenate([field_map.survey.positions, points]))
    marker = {
        "size": 4,
        "color": draw.for_display(sd),
        "colorscale": "Bluered",
        # Above the picture; the field's is below.
        "colorbar": draw.colorbar("m")
        | {"len": 0.6, "x": 0.3, "yref": "paper", "y": 1.0, "thickness": 8, "nticks": 3, "tickangle": 0},
    }
    path = draw.flat(cut.along(points), marker=marker, name="path")
    note = "; points: stated poses, coloured by sd"
    return magnitude_slice("|B| of the map", cut, *field_on(cut, field_map), limits_of(field_map), [path], note)


def _name(track: Track, k: int) -> str:
    names = sorted({e.map for e in track.estimates if e.is_stated and e.map is not None})
    return names[k] if names else track.maps[k].survey.name


def status_figure(track: Track) -> draw.Figure:
    """Probability of the best place along the path, and where a pose was accurate enough to be stated."""
    walked = path_walked(track.log.positions)
    shown, traces = np.column_stack([walked, [e.probability for e in track.estimates]]), []
    for phase in dict.fromkeys(e.phase for e in track.estimates):
        rows = np.array([e.phase == phase for e in track.estimates])
        traces.append(draw.flat(shown[rows], marker={"size": 4}, name=phase))
    alt = f"Probability that the best place is right; a pose for {track.is_stated.mean():.0%} of the samples."
    title = "How sure the place was"
    figure = draw.new_plane(title, traces, "path walked (m)", "probability", alt, is_equal=False)
    return figure.update_yaxes(range=[0, 1.02])


def sd_figure(result: LocalizationResult) -> draw.Figure:
    """How accurate the stated poses are, along the log."""
    t, shift, _ = np.array(result.sd).reshape(-1, 3).T
    trace = draw.flat(np.column_stack([t, shift]), marker={"size": 4}, name="sd")
    title, y_title = "How accurate the pose was", "sd in the worst direction (m)"
    alt = f"Standard deviation of the stated poses over time: {result.share_in_words}."
    return draw.new_plane(title, [trace], "t (s)", y_title, alt, is_equal=False)
