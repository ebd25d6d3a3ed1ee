# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch evaluate``: the benchmark, which is a separate package."""

from importlib.util import find_spec

import typer

from magmatch.cli.command import command
from magmatch.errors import MagmatchError

INSTALL = "pip install ./evaluation (in a checkout of magmatch)"


def evaluate(app: typer.Typer) -> None:
    """Add the subcommand of that package, or one that says what to install."""
    if find_spec("magmatch_evaluation") is not None:
        from magmatch_evaluation.program import EXAMPLES
        from magmatch_evaluation.program import evaluate as run

        command("evaluate", EXAMPLES)(run)(app)
        return
    whatever = {"allow_extra_args": True, "ignore_unknown_options": True}
    app.command("evaluate", context_settings=whatever, epilog=f"First: {INSTALL}")(_missing)


def _missing() -> None:
    """Run the benchmark, once the package 'magmatch-evaluation' is installed."""
    msg = f"the benchmark needs the package 'magmatch-evaluation': {INSTALL}"
    raise MagmatchError(msg)
