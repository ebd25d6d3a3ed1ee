# SPDX-License-Identifier: BSD-3-Clause
"""The report of `localize`: the verdict, the path over the map, and where it was lost and why."""

from pathlib import Path

from magmatch.localization.result import LocalizationResult, LocalizationStatus
from magmatch.localization.track import Track
from magmatch.viz.figures.track_figures import path_figure, sd_figure, status_figure
from magmatch.viz.pages.page import Section, again, bullets, figure_row, table, verdict, write_page

# Most parts listed one by one, the longest.
MAX_LISTED = 40
# Where the place is known at the end and the pose is not, nothing was lost.
UNCERTAIN = (
    "The place is known to the end, the pose not as well as asked for: see the standard deviations below.",
    "Turn and walk on, or along other lines: a field that varies along the path in all directions fixes the pose.",
    "If so much uncertainty will do, state it: --max-sd METRES,DEGREES.",
)
NEXT_STEPS = {
    LocalizationStatus.LOCALIZED: ("Use it: the TUM file holds the stated poses, in the map's frame.",),
    LocalizationStatus.LOST: (
        "See below where it was lost: either the body left the map, or the place has changed. Map it again there.",
        "Keep moving: a few correlation lengths of the field are enough to be found again.",
    ),
    LocalizationStatus.NEVER: (
        "Check units and --field-frame, and that map and log are of one place; calibrate raw logs with "
        "'magmatch prepare'.",
        "Walk farther, with turns; state how far the odometry drifts (--odometry-sd), and use --planar on one floor.",
    ),
}


def next_steps(result: LocalizationResult) -> tuple[str, ...]:
    """Say what to do, given how the log ended."""
    return UNCERTAIN if result.is_place_known else NEXT_STEPS[result.status]


def verdict_on(result: LocalizationResult) -> str:
    """Say where the log ended, and for how much of it a pose is stated; good news only if it ended localized."""
    ended = {LocalizationStatus.LOST: "Lost at the end"}.get(result.status, result.status.capitalize())
    ended = "Pose too uncertain at the end" if result.is_place_known else ended
    share = f"; {result.share_in_words}" if result.is_localized else ""
    return verdict(f"{ended}{share}", result.reason, is_good=result.status is LocalizationStatus.LOCALIZED)


def write_track_report(path: str | Path, track: Track, result: LocalizationResult) -> None:
    """Write one HTML page about a log in a map; it works offline and on a phone."""
    answer = [
        verdict_on(result),
        "<h2 id='next'>What to do next</h2>",
        bullets(next_steps(result)),
    ]
    sections = [Section("", answer)]
    sections += [
        Section(f"In {m.survey.name}", [figure_row([path_figure(track, k)])]) for k, m in enumerate(track.maps)
    ]
    longest = sorted(result.segments, key=lambda s: s.t0 - s.t1)[:MAX_LISTED]
    rows = [
        [f"{s.t0:.2f}", f"{s.t1 - s.t0:.1f} s", s.phase, s.map or "", s.why]
        for s in sorted(longest, key=lambda s: s.t0)
    ]
    columns = ["from (s)", "for", "phase", "map", "why"]
    sections.append(
        Section("Along the log", [figure_row([status_figure(track), sd_figure(result)]), table(rows, columns)])
    )
    sections.append(again("Run it again", "", None, result.config))
    write_page(path, f"magmatch: {track.log.name}", sections)
