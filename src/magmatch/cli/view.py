# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch view``: a picture of a survey, a map or a registration."""

from pathlib import Path
from typing import Annotated

import typer

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_result, read_survey_or_map
from magmatch.cli.narration import put
from magmatch.cli.outputs import check_outputs
from magmatch.errors import ConfigurationError

EXAMPLES = (
    "magmatch view survey.csv --field-unit uT --out survey.html",
    "magmatch view room.map --out room.html",
    "magmatch view result.json base.csv target.csv --out result.html",
)


def add_to(app: typer.Typer) -> None:
    """Add the subcommand."""
    command(app, "view", EXAMPLES, surveys=())(view)


def view(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Surveys, saved maps, or a registration result with its base and target.", metavar="FILE..."
        ),
    ],
    layouts: Layouts,
    out: Annotated[
        Path | None, typer.Option(help="Write here (HTML); by default named after the first file, in this folder.")
    ] = None,
) -> None:
    """Draw surveys, maps or a registration.

    One HTML page that works offline; its path goes to stdout.
    """
    from magmatch.data.sniff import sniff
    from magmatch.viz.plotting import require_plotly

    goal = out or Path(files[0].stem + ".html")
    check_outputs((goal,), inputs=files)
    require_plotly()
    from magmatch.viz.pages import write_view
    from magmatch.viz.report import write_report

    results = [path for path in files if sniff(path) == "registration"]
    drawn = [read_survey_or_map(path, layouts) for path in files if path not in results]
    if not results:
        write_view(goal, drawn)
    elif len(results) == 1 and len(drawn) in {0, 2}:
        base, target = drawn or (None, None)
        write_report(goal, base, target, read_result(results[0]))
    else:
        msg = (
            "expected surveys and maps, or one registration result, alone or with its base and target; "
            f"found {len(results)} results and {len(drawn)} surveys or maps"
        )
        raise ConfigurationError(msg)
    put(str(goal))
