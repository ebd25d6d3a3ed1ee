# SPDX-License-Identifier: BSD-3-Clause
"""Errors end here: each becomes one line on stderr and an exit code; a traceback only where asked for."""

import errno
import os
import sys
import traceback
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any

import typer

from magmatch.cli.narration import Narrator, say
from magmatch.errors import MagmatchError, TaskError

DONE, FAULT, BAD_INPUT, NOT_ACCEPTED, INTERRUPTED, READER_LEFT = 0, 1, 2, 3, 130, 141

# Errors that the user can correct (names, permissions); all other system errors are the machine's.
USER_ERRNOS = {
    errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR, errno.ENOTDIR, errno.EEXIST,
    errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL,
}  # fmt: skip
# Base of all complaints about options and arguments, whichever version of typer raises them.
UsageError = typer.BadParameter.__bases__[0]


def guarded(action: Callable[[], int | None], narrator: Narrator) -> int:
    """Run a command and turn whatever it raises into an exit code."""
    try:
        outcome = action()
        if outcome == INTERRUPTED:  # typer turns the interrupt into an exit of this code
            return _interrupted(narrator)
        sys.stdout.flush()
        narrator.finish()
    except (BrokenPipeError, SystemExit):  # typer exits by itself in this one case
        # Whoever read our output has left.
        _let_go_of_output()
        return READER_LEFT
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted(narrator)
    except Exception as error:
        narrator.rest()
        if narrator.is_debugging:
            traceback.print_exception(error)
        words, code = explain(error)
        say("magmatch: " + one_line(words))
        try:
            sys.stdout.flush()
        except OSError:
            _let_go_of_output()
        return code
    return outcome or DONE


def _let_go_of_output() -> None:
    """Keep Python from complaining at exit about what cannot be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def explain(error: Exception) -> tuple[str, int]:
    """The message for an error, and its exit code."""
    if isinstance(error, UsageError):
        return _explain_usage(error), BAD_INPUT
    match error:
        case TaskError():
            return str(error), FAULT
        case MagmatchError():
            return str(error), BAD_INPUT
        case OSError():
            place = f"{error.filename}: " if error.filename is not None else ""
            words = f"{place}{(error.strerror or str(error) or type(error).__name__)}"
            return words, BAD_INPUT if error.errno in USER_ERRNOS else FAULT
        case MemoryError():
            return f"out of memory ({error or 'no details'}); use fewer samples or a coarser map", FAULT
    return f"internal error, {type(error).__name__}: {error} (use --debug for details, and please report it)", FAULT


def one_line(text: str) -> str:
    """An error's message on one line, without control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def _interrupted(narrator: Narrator) -> int:
    narrator.rest()
    say("magmatch: interrupted")
    return INTERRUPTED


def _explain_usage(error: Any) -> str:
    """Typer's message, and where to read on."""
    typed, guesses = getattr(error, "option_name", None), getattr(error, "possibilities", None)
    if typed and guesses:
        # Typer compares them with their dashes, which all options share.
        near = get_close_matches(typed.strip("-"), [guess.strip("-") for guess in guesses])
        error.possibilities = [f"--{name}" for name in near]
    message: str = error.format_message()
    command = getattr(getattr(error, "ctx", None), "command_path", "magmatch")
    return f"{message.rstrip('.')} (see '{command} --help')"
