# SPDX-License-Identifier: BSD-3-Clause
"""All subcommands share this: examples in their help, common switches, and options for reading surveys."""

import inspect
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_type_hints

import typer
from pydantic import ValidationError

from magmatch.cli.narration import Narrator
from magmatch.data.formats.format import SurveyFormat
from magmatch.errors import ConfigurationError, first_fault


@dataclass(frozen=True, slots=True)
class Layouts:
    """How to read the surveys of one command: option values by (survey, setting); the survey "" stands for all."""

    given: dict[tuple[str, str], Any]

    def again(self, command: str, files: Sequence[Path], *more: object) -> str:
        """The line with which a command reads its files in the same way again."""
        words = ["magmatch", command, *files]
        for (of, name), value in self.given.items():
            flag = flag_of(of, name)
            words += ([flag] if value else []) if isinstance(value, bool) else [flag, value]
        return shlex.join(map(str, [*words, *more]))

    def of(self, survey: str = "") -> SurveyFormat:
        """Format of one survey: its own options, else those for all surveys, else the defaults."""
        chosen = {name: value for side in ("", survey) for (of, name), value in self.given.items() if of == side}
        try:
            return SurveyFormat.model_validate(chosen)
        except ValidationError as error:
            place, words = first_fault(error)
            msg = f"--{place.replace('_', '-')}: {words}"
            raise ConfigurationError(msg) from None


def command(
    name: str, examples: Sequence[str], surveys: Sequence[str] | None = None, *, reads: str = ""
) -> Callable[[Callable[..., int | None]], Callable[[typer.Typer], None]]:
    """Turn a function into one that adds it to the program as a subcommand, with options for reading its surveys.

    ``reads`` names, as the help does, the files that these options are of; ``surveys`` those with options of their
    own besides (None: there are none of either).
    """
    epilog = "\b\nExamples:\n" + "\n".join(f"  {example}" for example in examples)
    if surveys is not None and len(surveys) > 1:
        own = ", ".join(flag_of(survey, "field_unit") for survey in surveys)
        epilog = f"\b\nOptions for reading one file alone have its name in front:\n  {own}, and so on\n\n{epilog}"
    extra = {} if surveys is None else _layout_parameters(("", *surveys), reads)

    def decorate(function: Callable[..., int | None]) -> Callable[[typer.Typer], None]:
        @wraps(function)
        def call(**values: Any) -> int | None:
            if surveys is not None:
                given = {place: values.pop(key) for key, (place, _) in extra.items()}
                values["layouts"] = Layouts({place: value for place, value in given.items() if value is not None})
            return function(**{key: value for key, value in values.items() if key not in COMMON})

        # Typer reads the options of a command from the signature of its function.
        hints = get_type_hints(function, include_extras=True)
        shown = {p.name: (hints[p.name], p.default) for p in inspect.signature(function).parameters.values()}
        shown |= {key: (annotation, None) for key, (_, annotation) in extra.items()}
        shown |= {key: (annotation, False) for key, annotation in COMMON.items()}
        shown.pop("layouts", None)
        call.__annotations__ = {key: annotation for key, (annotation, _) in shown.items()}
        call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [
                inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
                for key, (annotation, default) in shown.items()
            ]
        )
        text = inspect.cleandoc(function.__doc__ or "")

        def add_to(app: typer.Typer) -> None:
            app.command(name, epilog=epilog, help=text, no_args_is_help=False)(call)

        return add_to

    return decorate


def narrator_of(ctx: typer.Context) -> Narrator:
    """The narrator of this run (a fresh one where the program is not run through `main`)."""
    root: Any = ctx.find_root()
    root.obj = root.obj or Narrator()
    return cast("Narrator", root.obj)


def _note_verbose(ctx: typer.Context, value: bool) -> None:
    narrator_of(ctx).is_verbose |= value


def _note_debug(ctx: typer.Context, value: bool) -> None:
    narrator_of(ctx).is_debugging |= value


Verbose = Annotated[bool, typer.Option("--verbose", help="Report each step on stderr.", callback=_note_verbose)]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.", callback=_note_debug)]
COMMON: dict[str, Any] = {"verbose": Verbose, "debug": Debug}
# Options that several commands have alike.
JSON = typer.Option(False, "--json", help="Print the result as JSON on stdout.")
PLANAR = typer.Option(False, "--planar", help="z is up, and all poses lie at one height. Detected if they show it.")
G2oRotation = Literal["quaternion", "angle"]
G2O_ROTATION = typer.Option(
    "quaternion", help="Convention of a g2o edge's rotation information: quaternion (g2o) or angle (GTSAM, Ceres)."
)
RERUN = typer.Option(None, help="Write a recording for the Rerun viewer here (.rrd).")
SEED = typer.Option(0, help="Same input, settings and seed give the same answer.", min=0)


def _layout_parameters(surveys: Sequence[str], reads: str) -> dict[str, tuple[tuple[str, str], Any]]:
    """One option per setting of `SurveyFormat` and survey: parameter name -> ((survey, setting), annotation).

    Those of one survey are understood but not listed: they would say everything twice.
    """
    parameters: dict[str, tuple[tuple[str, str], Any]] = {}
    for survey, (name, field) in product(surveys, SurveyFormat.model_fields.items()):
        what, kind = str(field.description), cast("Any", field.annotation)
        # A placeholder keeps its capitals.
        first = what[0] if what[1:2].isupper() else what[0].lower()
        flag, words = flag_of(survey, name), f"{reads}: {first}{what[1:]}"
        option = typer.Option(flag, help=words, show_default=False, hidden=bool(survey))
        parameters[flag.strip("-").replace("-", "_")] = ((survey, name), Annotated[kind | None, option])
    return parameters


def flag_of(survey: str, setting: str) -> str:
    """Option of one setting, for one survey or for all."""
    return "--" + (f"{survey}_{setting}" if survey else setting).replace("_", "-")
