# SPDX-License-Identifier: BSD-3-Clause
"""Entry point: the subcommands, and the boundary at which errors become one line and an exit code."""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from magmatch._version import __version__
from magmatch.cli.added import add_others
from magmatch.cli.boundary import guarded
from magmatch.cli.command import Debug, Verbose
from magmatch.cli.commands.convert import convert
from magmatch.cli.commands.datasets import datasets
from magmatch.cli.commands.demo import demo
from magmatch.cli.commands.glossary import glossary
from magmatch.cli.commands.info import info
from magmatch.cli.commands.localize import localize
from magmatch.cli.commands.map import build
from magmatch.cli.commands.merge import merge
from magmatch.cli.commands.odometry import odometry
from magmatch.cli.commands.prepare import prepare
from magmatch.cli.commands.query import query
from magmatch.cli.commands.register import register
from magmatch.cli.commands.simulate import simulate
from magmatch.cli.commands.slam import slam
from magmatch.cli.commands.transform import transform
from magmatch.cli.commands.view import view
from magmatch.cli.narration import narrated, put

EPILOG = """\b
Examples:
  magmatch demo
  magmatch register base.csv target.csv --out result.json --report result.html
  magmatch info survey.csv

\b
Exit codes:
  0  done (register: accepted; slam, merge: all in one frame; localize: at least one pose)
  1  internal or system error
  2  bad input or usage, explained in one line on stderr
  3  register: not accepted; slam, merge: not everything is in one frame; localize: never localized
"""

# In the order of the help page, where those of other distributions follow.
COMMANDS = (
    register, transform, slam, merge, localize, odometry, prepare, build, query, info, view, convert, simulate,
    datasets, demo, glossary,
)  # fmt: skip


def build_app() -> typer.Typer:
    """Put the program together."""
    app = typer.Typer(
        name="magmatch", add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False, epilog=EPILOG
    )
    app.callback()(_program)
    for add_to in COMMANDS:
        add_to(app)
    add_others(app)
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line on the words after ``magmatch``, those of this process by default; gives the exit code."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    app = build_app()
    with narrated() as narrator:
        return guarded(
            lambda: app(words or ["--help"], prog_name="magmatch", standalone_mode=False, obj=narrator), narrator
        )


def _show_version(value: bool) -> None:
    if value:
        put(f"magmatch {__version__}")
        raise typer.Exit


def _program(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True)
    ] = False,
    verbose: Verbose = False,
    debug: Debug = False,
) -> None:
    """Build magnetic maps, register them, correct odometry drift with them, and localise in them."""
