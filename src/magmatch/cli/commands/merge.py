# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch merge``: rigid surveys of one place into one frame and one map."""

from pathlib import Path
from typing import Annotated

import typer

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_poses_of, read_survey_or_map, require_own_poses
from magmatch.cli.option_values import processes, refuse
from magmatch.cli.outputs import check_folder
from magmatch.cli.sessions import deliver
from magmatch.cli.settings import registration_config, with_prior

EXAMPLES = (
    "magmatch merge monday.csv tuesday.csv friday.csv --out hall",
    "magmatch merge east.map west.map --out building",
    "magmatch merge mon.map tue.map wed.map thu.map --jobs 4 --out hall",
    "magmatch merge robot.csv phone.csv table.csv --field-unit uT --planar --out room",
)


@command("merge", EXAMPLES, surveys=(), reads="every SURVEY")
def merge(
    surveys: Annotated[
        list[Path], typer.Argument(help="Surveys or saved maps, each rigid, in its own frame.", metavar="SURVEY")
    ],
    out: Annotated[Path, typer.Option(help="Folder for surveys, maps, graph, report and result.")],
    layouts: Layouts,
    gravity_aligned: Annotated[bool, typer.Option("--gravity-aligned", help="z points up in all surveys.")] = False,
    planar: Annotated[bool, typer.Option("--planar", help="As --gravity-aligned, with a common height.")] = False,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of registration settings, or an earlier result.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that register pairs.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler whose workers do so instead, tcp://HOST:PORT.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Same input, settings and seed give the same answer.", min=0)] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")] = False,
) -> int:
    """Bring SURVEYs into one frame and one map.

    Every pair is registered; pairs that contradict the others are rejected. For logs whose poses drift, see 'slam'.

    If interrupted, the same command resumes where it stopped.

    Exit code 0: all are in one frame; 3: not all. The result is written in either case.
    """
    from magmatch.registration.maps import survey_of
    from magmatch.slam.merge import merge as merged
    from magmatch.slam.output.folder import require_folder, unfinished

    if len(surveys) < 2:
        refuse("SURVEY", "at least two surveys", str(surveys[0]))
    require_own_poses(surveys, layouts, "SURVEY")
    check_folder(out)
    settings = with_prior(registration_config("default", config), None, None, gravity_aligned, None, planar)
    read = [read_survey_or_map(path, layouts) for path in surveys]
    require_folder(out, [survey_of(one) for one in read], [*surveys, *([config] if config else [])])
    poses = [read_poses_of(path, layouts) for path in surveys]
    with processes(jobs, scheduler) as run:
        session = merged(read, settings, seed=seed, run=run, keep=unfinished(out))
    words = ["merge", *map(str, surveys), *layouts.words(), "--seed", str(seed)]
    return deliver(session, out, words, poses, json=json)
