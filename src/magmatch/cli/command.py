# SPDX-License-Identifier: BSD-3-Clause
"""All subcommands share this: examples in their help, common switches, and options for reading surveys."""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any, cast, get_type_hints

import typer
from pydantic import ValidationError

from magmatch.cli.narration import Narrator
from magmatch.data.formats.format import SurveyFormat
from magmatch.errors import ConfigurationError, first_fault


@dataclass(frozen=True, slots=True)
class Layouts:
    """How to read the surveys of one command: option values by (survey, setting); the survey "" stands for all."""

    given: dict[tuple[str, str], Any]

    def words(self) -> list[str]:
        """The options as they would be typed."""
        words = []
        for (of, name), value in self.given.items():
            flag = flag_of(of, name)
            words += ([flag] if value else []) if isinstance(value, bool) else [flag, str(value)]
        return words

    def of(self, survey: str = "") -> SurveyFormat:
        """Format of one survey: its own options, else those for all surveys, else the defaults."""
        general = {name: value for (of, name), value in self.given.items() if of == ""}
        own = {name: value for (of, name), value in self.given.items() if of == survey}
        try:
            return SurveyFormat.model_validate(general | own)
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
        hints = get_type_hints(function, include_extras=True)
        hints.pop("layouts", None)

        @wraps(function)
        def call(**values: Any) -> int | None:
            values = {key: value for key, value in values.items() if key not in COMMON}
            if surveys is not None:
                found = {place: values.pop(key) for key, (place, _) in extra.items()}
                values["layouts"] = Layouts({place: value for place, value in found.items() if value is not None})
            return function(**values)

        annotations = hints | {key: annotation for key, (_, annotation) in extra.items()} | COMMON
        own = [p for p in inspect.signature(function).parameters.values() if p.name != "layouts"]
        defaults = [_keyword(key, annotations[key], None) for key in extra]
        defaults += [_keyword(key, annotation, False) for key, annotation in COMMON.items()]
        as_keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[p.name]) for p in own]
        call.__signature__ = inspect.Signature(as_keywords + defaults)  # type: ignore[attr-defined]
        call.__annotations__ = annotations
        help_text = inspect.cleandoc(function.__doc__ or "")

        def add_to(app: typer.Typer) -> None:
            app.command(name, epilog=epilog, help=help_text, no_args_is_help=False)(call)

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


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _layout_parameters(surveys: Sequence[str], reads: str) -> dict[str, tuple[tuple[str, str], Any]]:
    """One option per setting of `SurveyFormat` and survey: parameter name -> ((survey, setting), annotation).

    Those of one survey are understood but not listed: they would say everything twice.
    """
    parameters: dict[str, tuple[tuple[str, str], Any]] = {}
    for survey in surveys:
        prefix = f"{survey}_" if survey else ""
        for name, field in SurveyFormat.model_fields.items():
            flag = flag_of(survey, name)
            what = str(field.description)
            # A placeholder keeps its capitals.
            first = what[0] if what[1:2].isupper() else what[0].lower()
            words = f"{reads}: {first}{what[1:]}"
            option = typer.Option(flag, help=words, show_default=False, hidden=bool(survey))
            kind: Any = field.annotation
            parameters[prefix + name] = ((survey, name), Annotated[kind | None, option])
    return parameters


def flag_of(survey: str, setting: str) -> str:
    """Option of one setting, for one survey or for all."""
    return "--" + (f"{survey}_{setting}" if survey else setting).replace("_", "-")
