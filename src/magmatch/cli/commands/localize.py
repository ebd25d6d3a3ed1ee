# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch localize``: where a log's body was in a map."""

from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Option

from magmatch.cli.command import JSON, PLANAR, Layouts, command
from magmatch.cli.inputs import read_poses_of
from magmatch.cli.narration import say
from magmatch.cli.option_values import numbers, refuse, vertical
from magmatch.cli.outputs import answer, check_outputs
from magmatch.cli.settings import merged, with_limits

if TYPE_CHECKING:
    from magmatch.localization.result import LocalizationResult

EXAMPLES = (
    "magmatch localize hall.map walk.csv --out where.tum",
    "magmatch localize buildings/ robot.mcap --out where.tum --report where.html",
    "magmatch localize hall.map phone.zip --planar --out where.tum --json > where.json",
    "magmatch localize hall.map walk.csv --live --max-sd 0.3,5 --out where.tum",
)


@command("localize", EXAMPLES, surveys=(), reads="LOG")
def localize(
    layouts: Layouts,
    place: Path = Argument(..., help="A saved map, its index, or a folder of maps.", metavar="MAP"),
    log: Path = Argument(
        ..., help="Log with odometry and field, in its own frame; or a phone's raw log.", metavar="LOG"
    ),
    out: Path = Option(..., help="Write the stated poses here (TUM).", metavar="TRAJECTORY"),
    live: bool = Option(
        False, "--live", help="Estimate each pose from earlier samples only, not from the whole log."
    ),
    planar: bool = PLANAR,
    no_gravity: bool = Option(False, "--no-gravity", help="z of map and log is not up."),
    odometry_sd: str | None = Option(
        None,
        help="Standard deviation of odometry after 10 m: METRES,DEGREES; learned from there.  [default: 0.15,2; "
        "of a phone's log without poses 0.5,6]",
    ),
    min_probability: float | None = Option(None, help="Least probability of a stated pose.  [default: 0.99]"),
    max_sd: str | None = Option(
        None, help="Largest standard deviation of a stated pose: METRES,DEGREES.  [default: 2,30]"
    ),
    report: Path | None = Option(None, help="Write a page with the path over the map here."),
    config: Path | None = Option(None, help="YAML file of settings, or an earlier result."),
    json: bool = JSON,
) -> int:
    """Find where LOG's body was in MAP's frame.

    The start is unknown. Poses are written only where they are certain, with the required probability and accuracy.

    Exit code 0: at least one pose is stated; 3: never localized, with the reason.
    """
    from magmatch.localization.config import LocalizerConfig
    from magmatch.localization.known_places import open_place
    from magmatch.localization.localize import localize as run
    from magmatch.preparation.odometry.open_walk import open_walk

    switches = vertical(planar=planar, no_gravity=no_gravity)
    check_outputs((out,), inputs=(place, log, config), page=report)
    settings = with_limits(merged(LocalizerConfig(), config), min_probability, max_sd)
    if odometry_sd is not None:
        sd = tuple(numbers("--odometry-sd", odometry_sd, 2, "metres,degrees, such as 0.3,4"))
        if min(sd) <= 0:
            refuse("--odometry-sd", "metres,degrees, both above 0, such as 0.3,4", odometry_sd)
        switches["odometry"] = settings.odometry.model_copy(update={"sd": sd})
    settings = settings.model_copy(update=switches)
    # Both before a log is dead reckoned.
    opened, known = open_walk(log, layouts.of(), with_points=False), open_place(place)
    walk = opened.survey(say)
    track = run(known, walk, settings, live=live)
    result = track.result()
    track.save(out, read_poses_of(log, layouts))
    if report is not None:
        from magmatch.viz.pages.track_page import write_track_report

        write_track_report(report, track, result)
    words = f"{tell(result)}\nWrote {out}{f' and {report}' if report else ''}"
    return answer(result, words, is_good=result.is_localized, json=json)


def tell(result: "LocalizationResult") -> str:
    """Summarise a result in a line or two."""
    level = "Taken as planar: every pose lies at one height\n" if result.is_planar else ""
    which = f"\n  {result.maps_in_words}" if result.maps else ""
    if result.first_fix is None or result.sensor is None:
        return f"{level}Never localized: {result.reason}{which}"
    where = f" in {result.map}" if result.map else ""
    ended = "Pose too uncertain at the end" if result.is_place_known else result.status.capitalize()
    bias = ", ".join(f"{1e6 * b:z.1f}" for b in result.sensor["bias"])
    return (
        f"{level}{ended}{where}: {result.reason}\n"
        f"  first after {result.first_fix[1]:.1f} m; {result.share_in_words}; bias {bias} uT{which}"
    )
