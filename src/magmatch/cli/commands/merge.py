# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch merge``: rigid surveys of one place into one frame and one map."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import G2O_ROTATION, JSON, SEED, G2oRotation, Layouts, command
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
    layouts: Layouts,
    surveys: list[Path] = Argument(
        ..., help="Surveys or saved maps, each rigid, in its own frame.", metavar="SURVEY"
    ),
    out: Path = Option(..., help="Folder for surveys, maps, graph, report and result."),
    gravity_aligned: bool = Option(False, "--gravity-aligned", help="z points up in all surveys."),
    planar: bool = Option(False, "--planar", help="As --gravity-aligned, and all frames agree in height."),
    config: Path | None = Option(None, help="YAML file of registration settings, or an earlier result."),
    jobs: int = Option(1, min=1, help="Processes that register pairs."),
    scheduler: str | None = Option(None, help="Dask scheduler whose workers do so instead, tcp://HOST:PORT."),
    g2o_rotation: G2oRotation = G2O_ROTATION,
    seed: int = SEED,
    json: bool = JSON,
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
    settings = registration_config("default", config)
    settings = with_prior(settings, is_aligned=gravity_aligned, is_planar=planar)
    read = [read_survey_or_map(path, layouts) for path in surveys]
    require_folder(out, [survey_of(one) for one in read], [*surveys, *([config] if config else [])])
    poses = [read_poses_of(path, layouts) for path in surveys]
    with processes(jobs, scheduler) as run:
        session = merged(read, settings, seed=seed, run=run, keep=unfinished(out))
    again = layouts.again("merge", surveys, "--seed", seed, "--config", "settings.yaml", "--out", out)
    return deliver(session, out, again, poses, g2o_rotation, json=json)
