# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch slam``: correct logs whose poses drift, and bring them into one frame."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Option

from magmatch.cli.command import G2O_ROTATION, JSON, PLANAR, RERUN, G2oRotation, Layouts, command
from magmatch.cli.inputs import logs_in, read_poses_of, require_own_poses
from magmatch.cli.narration import say
from magmatch.cli.option_values import numbers, processes, refuse, vertical
from magmatch.cli.outputs import check_folder, check_outputs
from magmatch.cli.sessions import deliver
from magmatch.cli.settings import merged

if TYPE_CHECKING:
    from magmatch.slam.config import SlamConfig

EXAMPLES = (
    "magmatch slam walk.csv --out corrected",
    "magmatch slam monday.mcap tuesday.mcap --out building",
    "magmatch slam phone.zip --out floor",
    "magmatch slam robot.csv phone.csv --odometry-sd 0.1,1 --odometry-sd phone:0.5,8 --out hall",
    "magmatch slam phone.csv --field-frame sensor --field-unit uT --planar --out floor",
    "magmatch slam robot.csv --anchors points.csv --out hall",
    "magmatch slam monday.mcap tuesday.mcap friday.mcap --jobs 4 --out building",
    "magmatch slam monday.mcap tuesday.mcap friday.mcap --continue --out building",
    "magmatch slam drone.bag --no-gravity --json --out room > room.json",
)
SD = "metres,degrees or NAME:metres,degrees, none below 0, such as 0.3,4"


@command("slam", EXAMPLES, surveys=(), reads="every LOG")
def slam(
    layouts: Layouts,
    logs: list[Path] = Argument(
        ...,
        help="Logs with odometry and field, each in its own frame; or a phone's raw logs; or a folder of logs.",
        metavar="LOG",
    ),
    out: Path = Option(..., help="Folder for trajectories, surveys, maps, graph, report and result."),
    odometry_sd: list[str] | None = Option(
        None,
        help="Standard deviation of odometry after 10 m: METRES,DEGREES, or NAME:METRES,DEGREES for one log.  "
        "[default: from the covariance in nav_msgs/Odometry if it is plausible, else 0.3,4]",
    ),
    planar: bool = PLANAR,
    no_gravity: bool = Option(False, "--no-gravity", help="z of the logs is not up."),
    anchors: Path | None = Option(
        None,
        help="Known positions of logs at given times: a table log,t,x,y,z,sd, always in s (or dates) and m; or "
        "lat,lon for x,y.",
    ),
    no_waypoints: bool = Option(
        False, "--no-waypoints", help="Do not use surveyed points that a phone's log holds itself."
    ),
    is_more: bool = Option(
        False, "--continue", help="Add those LOGs that are not yet in the folder's result, and keep the others."
    ),
    config: Path | None = Option(None, help="YAML file of settings, or an earlier result."),
    jobs: int = Option(1, min=1, help="Processes that map and compare stretches of path."),
    scheduler: str | None = Option(None, help="Dask scheduler whose workers do so instead, tcp://HOST:PORT."),
    g2o_rotation: G2oRotation = G2O_ROTATION,
    rerun: Path | None = RERUN,
    json: bool = JSON,
) -> int:
    """Correct the drift of LOGs, and bring them into one frame.

    One map is made of them. Where a log revisits a place, the field shows it. Such closures correct the poses and
    tie logs to each other.

    If interrupted, the same command resumes where it stopped. With --anchors, or where a phone's log holds surveyed
    points, the frame is that of these fixed points, if they determine it; points in degrees become metres east and
    north of the first.

    Exit code 0: all logs are in one frame (a single log: corrected); 3: not all, or nothing to correct. The result is
    written in either case.
    """
    from magmatch.data.checks import require_walk
    from magmatch.data.logs.drift import read_drift
    from magmatch.preparation.odometry.open_walk import open_walk
    from magmatch.slam.config import SlamConfig
    from magmatch.slam.graph.anchors import in_metres, of_named, read_anchors
    from magmatch.slam.output.folder import require_folder, unfinished
    from magmatch.slam.output.kept_session import read_session, session_in
    from magmatch.slam.session import Session, unique_stems

    switches = vertical(planar=planar, no_gravity=no_gravity)
    if is_more and (planar or no_gravity or odometry_sd or config):
        refuse("--continue", "the settings of the session that it continues", "others")
    asked, logs = logs, logs_in(logs)
    require_own_poses(logs, layouts, "LOG")
    check_folder(out)
    check_outputs((), logs, recording=rerun)
    settings = merged(SlamConfig(), config).model_copy(update=switches)
    settings = with_odometry_sd(settings, odometry_sd or [], logs)
    surveyed = [] if anchors is None else read_anchors(anchors)
    with processes(jobs, scheduler, ahead=2) as run:
        walks = [open_walk(path, layouts.of(), with_points=not no_waypoints) for path in logs]
        names = [path.name for path in logs]
        of_named(surveyed, names, unique_stems(names), [walk.span for walk in walks])
        for walk in walks:
            if walk.given is not None:
                require_walk(walk.given)
        files = [path for path in (*logs, config, anchors) if path]
        require_folder(out, None, files)
        kept = session_in(out) if is_more else None
        if kept is not None:
            in_metres(surveyed, kept[1]["stated"]["origin"], [a for a, _ in kept[1]["anchors"]])
        surveys = [walk.survey(say) for walk in walks]
        if not any(":" not in text for text in odometry_sd or []):
            stated = {path.name: read_drift(path, layouts.of()) for path in logs}
            sd_of_logs = {name: sd for name, sd in stated.items() if sd} | settings.sd_of_logs
            settings = settings.model_copy(update={"sd_of_logs": sd_of_logs})
        require_folder(out, surveys, files, may_be_more=is_more, to_add="add the others with --continue, ")
        poses = [read_poses_of(path, layouts) for path in logs]
        session, new = read_session(out, surveys, kept) if is_more else (Session(settings), surveys)
        session.add_logs(new, surveyed, waypoints=not no_waypoints, run=run, keep=unfinished(out))
    # A session has its logs in the order in which they were added.
    poses = [poses[next(k for k, s in enumerate(surveys) if s is survey)] for survey in session.given]
    more = [*(["--anchors", anchors] if anchors else []), *(["--no-waypoints"] if no_waypoints else [])]
    again = layouts.again("slam", asked, *more, "--config", "settings.yaml", "--out", out)
    return deliver(session, out, again, poses, g2o_rotation, json=json, rerun=rerun)


def with_odometry_sd(settings: "SlamConfig", said: Sequence[str], logs: Sequence[Path]) -> "SlamConfig":
    """Put the stated drift into the settings: of all logs, or of those with a given name."""
    for text in said:
        name, _, pair = text.rpartition(":")
        sd = tuple(numbers("--odometry-sd", pair, 2, SD))
        if min(sd) < 0:
            refuse("--odometry-sd", SD, text)
        if not name:
            odometry = settings.odometry.model_copy(update={"sd": sd})
            settings = settings.model_copy(update={"odometry": odometry})
            continue
        named = {path.name: sd for path in logs if name in (path.name, path.stem)}
        if not named:
            refuse("--odometry-sd", f"the name of a log ({', '.join(path.stem for path in logs)})", name)
        settings = settings.model_copy(update={"sd_of_logs": settings.sd_of_logs | named})
    return settings
