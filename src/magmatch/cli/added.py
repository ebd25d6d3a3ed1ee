# SPDX-License-Identifier: BSD-3-Clause
"""Commands that other distributions add: entry points of one group, each a function that adds one command."""

from importlib.metadata import entry_points
from typing import Never

import typer

from magmatch.errors import MagmatchError

GROUP = "magmatch.commands"
# Commands of this repository's other distributions, with what a checkout installs them from.
ELSEWHERE = {
    "serve": "./packages/magmatch-serve",
    "replay": "./packages/magmatch-serve",
    "evaluate": "./packages/magmatch-evaluation",
}
# A command that is missing takes whatever words it is given, and says what is missing.
WHATEVER = {"allow_extra_args": True, "ignore_unknown_options": True}


def add_others(app: typer.Typer) -> None:
    """Add the commands of installed distributions; those known from elsewhere say what to install for them."""
    installed = {point.name: point for point in entry_points(group=GROUP)}
    for name in ELSEWHERE | dict.fromkeys(sorted(installed)):
        why = "is not installed"
        try:
            if name in installed:
                installed[name].load()(app)
                continue
        except Exception as error:  # whatever another package does, the other commands work
            why = f"cannot be loaded ({error})"
        _add_missing(app, name, why)


def _add_missing(app: typer.Typer, name: str, why: str) -> None:
    """Add a command that says what to install."""
    remedy = f"pip install {ELSEWHERE[name]} (in a checkout of magmatch)" if name in ELSEWHERE else "install it anew"

    @app.command(name, context_settings=WHATEVER, help=f"(Needs: {remedy})")
    def missing() -> Never:
        msg = f"the command '{name}' comes from a package that {why}: {remedy}"
        raise MagmatchError(msg)
