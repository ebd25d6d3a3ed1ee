# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch replay``: send a log to a running service."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magmatch.cli.boundary import DONE, NOT_ACCEPTED
from magmatch.cli.command import Layouts, command
from magmatch.cli.narration import say
from magmatch.cli.option_values import refuse
from magmatch.cli.outputs import check_outputs
from magmatch_serve.commands.serve import read_token

if TYPE_CHECKING:
    from magmatch_serve.replay import Replayed

EXAMPLES = (
    "magmatch replay walk.csv --url http://127.0.0.1:8123",
    "magmatch replay robot.mcap --url http://127.0.0.1:8123 --speed 5 --out where.tum",
    "magmatch replay walk.csv --url https://maps.example.org --token-file token.txt",
)


@command("replay", EXAMPLES, surveys=(), reads="LOG")
def replay(
    log: Annotated[Path, typer.Argument(help="Log with odometry and field; or a phone's raw log.", metavar="LOG")],
    url: Annotated[str, typer.Option(help="Address of the service, as printed by 'magmatch serve'.")],
    layouts: Layouts,
    speed: Annotated[float, typer.Option(help="Speed relative to the recording.")] = 1.0,
    token_file: Annotated[Path | None, typer.Option(help="File with the service's token.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write the stated poses here (TUM).")] = None,
) -> int:
    """Send LOG to a service as if it were recorded now.

    Exit code 0: at least one pose was stated; 3: none was.
    """
    from magmatch.data.tables.tum import write_poses
    from magmatch.preparation.odometry.open_walk import open_walk
    from magmatch_serve.replay import live_url
    from magmatch_serve.replay import replay as run

    live_url(url)
    if not 0 < speed < float("inf"):
        refuse("--speed", "a number above 0", str(speed))
    check_outputs((out,), inputs=(log,))
    token = None if token_file is None else read_token(token_file)
    status = reason = ""

    def follow(said: dict[str, Any]) -> None:
        nonlocal status, reason
        reason = said["reason"]
        if said["status"] != status:
            status = said["status"]
            say(f"{said['t']:.2f} s  {status.replace('_', ' ')}")

    found = run(
        open_walk(log, layouts.of(), with_points=False).survey(say), url, speed=speed, token=token, on_pose=follow
    )
    say(tell(found, reason))
    if out is not None:
        write_poses(out, found.times, found.poses)
        say(f"Wrote {out}")
    return DONE if found.poses is not None else NOT_ACCEPTED


def tell(found: "Replayed", reason: str) -> str:
    """Summarise the answers in a line, with the last one's reason where none had a pose."""
    refused = f", {found.n_errors} samples refused" if found.n_errors else ""
    why = f": {reason}" if found.poses is None and reason else ""
    return f"{found.n_answers} answers, {len(found.times)} with a pose{refused}{why}"
