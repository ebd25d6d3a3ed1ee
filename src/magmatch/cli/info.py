# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch info``: what a file holds."""

from pathlib import Path
from typing import Annotated, Any

import typer

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map, read_result
from magmatch.cli.narration import put
from magmatch.cli.outputs import as_json
from magmatch.cli.summaries import info_table, tell_result

EXAMPLES = (
    "magmatch info survey.csv --field-unit uT",
    "magmatch info room.map --json",
    "magmatch info drive.mcap",
    "magmatch info result.json",
)


@command("info", EXAMPLES, surveys=())
def info(
    file: Annotated[
        Path, typer.Argument(help="Survey, log, saved map, trajectory or registration result.", metavar="FILE")
    ],
    layouts: Layouts,
    json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show what FILE holds.

    Counts, extent, units, frames, gaps and quality warnings.
    """
    from magmatch.data.formats.sniff import sniff

    kind = sniff(file)
    if kind == "registration":
        result = read_result(file)
        put(as_json({"kind": "registration"} | result.to_dict()) if json else tell_result(result))
        return
    facts = {"kind": {"tum": "trajectory", "map": "map", "log": "log"}.get(kind, "survey"), "file": str(file)}
    facts |= {"map": _of_map, "tum": _of_trajectory, "log": _of_log}.get(kind, _of_survey)(file, layouts)
    put(as_json(facts) if json else info_table(facts))


def _of_log(path: Path, layouts: Layouts) -> dict[str, Any]:
    """Topics of a recorder log, and the survey in it where there is one."""
    from magmatch.data.logs.read import list_topics
    from magmatch.errors import MagmatchError

    layout = layouts.of()
    topics, chosen = list_topics(path, layout)
    facts: dict[str, Any] = {"topics": [topic.facts() for topic in topics], "chosen": chosen}
    try:
        return facts | _of_survey(path, layouts)
    except MagmatchError as error:
        return facts | {"no_survey": str(error)}


def _of_survey(path: Path, layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.describe import describe
    from magmatch.data.read import read_unchecked

    return describe(*read_unchecked(path, layouts.of()))


def _of_map(path: Path, _layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.describe import describe

    field_map = read_map(path)
    numbers = field_map.hyperparameters.as_dict()
    facts: dict[str, Any] = {"prior": field_map.config.prior}
    if field_map.config.comparison:
        facts["left_out_error"] = field_map.config.comparison
    return facts | {"hyperparameters": numbers} | describe(field_map.survey)


def _of_trajectory(path: Path, _layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.trajectory import Trajectory

    trajectory = Trajectory.load(path)
    times, p = trajectory.times, trajectory.positions
    return {
        "poses": len(times),
        "units": {"length": "m", "time": "s"},
        "low": p.min(axis=0).tolist(),
        "high": p.max(axis=0).tolist(),
        "time": {"first": float(times[0]), "last": float(times[-1]), "duration": float(times[-1] - times[0])},
    }
