# SPDX-License-Identifier: BSD-3-Clause
"""How loops are compiled: at their first use on a machine, then kept in numba's cache.

A new user waits for that before the first answer, so it must be short. One signature per loop: one type and memory
layout per argument. No exceptions, strings or `numpy.linalg` inside; nor, on the way of a registration, allocations,
slices or array expressions: each drags more of numba's library through the compiler than the loop itself. A loop that
allocates nothing needs no counts of references (`_nrt`); one that only loops call needs no way in from Python.
"""

import atexit
import logging
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from time import perf_counter
from typing import Any

from numba import njit, types
from numba.core import event, sigutils

log = logging.getLogger(__name__)
# Above information and below a warning: to be told at once.
NOTICE = 25
# s between words about compiling where nothing else shows that the program is alive, as in a log file.
PATIENCE = 15.0
ELSEWHERE = "; NUMBA_CACHE_DIR names another folder to keep them"


class Keeping:
    """Loops are kept for later runs where some folder can be written; without one they are compiled each time."""

    def __init__(self) -> None:
        self.obstacle = ""  # why loops cannot be kept; empty as long as they can

    def __call__(self, loop: Any) -> Any:
        """Have a loop kept."""
        if not hasattr(loop, "enable_caching"):  # numba is told to compile nothing
            return loop
        try:
            loop.enable_caching()
        except RuntimeError:  # numba's word for no folder that it can write
            self.obstacle = "neither the package's folder nor the user's cache can be written"
            return loop
        cache = loop._cache
        load, save = cache.load_overload, cache.save_overload

        def loaded(*of: Any) -> Any:
            try:
                return load(*of)
            except Exception:  # whatever damaged or foreign files make of unpickling
                with suppress(Exception):
                    cache.flush()
                return None

        def saved(*what: Any) -> None:
            try:
                save(*what)
            except Exception as error:  # a full disk, or the same files
                if not self.obstacle:
                    self.obstacle = f"{cache.cache_path} cannot be written ({error})"
                    log.log(NOTICE, "Compiled loops are not kept: %s%s", self.obstacle, ELSEWHERE)

        cache.load_overload, cache.save_overload = loaded, saved
        return loop


KEEPING = Keeping()


def _compiled(**options: bool) -> Callable[[Any], Any]:
    """Compile at the first call; the numpy error model: division by 0 is infinity, nothing can be raised."""
    decorate = njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)  # type: ignore[call-overload]
    return lambda function: KEEPING(decorate(function))


# A loop; one that allocates arrays; one that only other loops call.
compiled, allocating, subroutine = _compiled(_nrt=False), _compiled(), _compiled(_nrt=False, no_cpython_wrapper=True)


def inlined(function: Any) -> Any:
    """Make a loop part of the one that calls it before that is compiled: counts known there are known here."""
    return KEEPING(njit(nogil=True, error_model="numpy", inline="always")(function))


_known: list[tuple[Any, tuple[types.Type, ...]]] = []


def record(kind: type, fields: str) -> Any:
    """Type of a named tuple as loops see it, from the types of its fields."""
    return types.BaseTuple.from_types(_types(fields), kind)  # type: ignore[no-untyped-call]


def compiled_ahead(*arguments: str | types.Type) -> Callable[[Any], Any]:
    """Compile a loop whose signature is known, so that another process may do it before it is called."""
    signature = tuple(one for part in arguments for one in (_types(part) if isinstance(part, str) else (part,)))

    def decorate(function: Any) -> Any:
        loop = compiled(function)
        _known.append((loop, signature))
        return loop

    return decorate


def _types(words: str) -> tuple[types.Type, ...]:
    """Types of values that are listed, such as ``f8, i8[::1]``."""
    return tuple(sigutils.normalize_signature(f"({words},)")[0])  # type: ignore[no-untyped-call]


def compile_known(module: str) -> None:
    """Compile the loops of a module, and of those that it imports, whose signatures are known: last ones first."""
    import_module(module)
    # Who calls them compiles the first ones meanwhile: they meet in the middle.
    for loop, signature in reversed(_known):
        loop.compile(signature)


class FirstUse(event.Listener):
    """Loops that are not in the cache say why it takes longer, report progress, and at the first give help."""

    def __init__(self) -> None:
        # Whose loops are compiled by another process meanwhile (`compile_known`). The library starts none by itself.
        self.next_module: str | None = None
        self._n_loops = 0
        self._began = self._said = 0.0

    def on_start(self, event: event.Event) -> None:
        """Hear of a compilation."""
        if not event.data["dispatcher"].py_func.__module__.startswith("magmatch."):
            return
        self._n_loops += 1
        if self._n_loops > 1:
            self._tell_progress()
            return
        self._began = self._said = perf_counter()
        how_often = "once per kind of task after installation or upgrade: a minute on two cores"
        if KEEPING.obstacle:
            how_often = f"in every run, since {KEEPING.obstacle}{ELSEWHERE}"
        log.log(NOTICE, "Compiling numerical loops, %s", how_often)
        if self.next_module is not None and not KEEPING.obstacle:
            words = f"from magmatch.compiled import compile_known; compile_known({self.next_module!r})"
            silent = subprocess.DEVNULL
            helper = subprocess.Popen([sys.executable, "-c", words], stdin=silent, stdout=silent, stderr=silent)
            # The cache is written file by file: what is not ready then is compiled when it is needed.
            atexit.register(_end, helper)

    def _tell_progress(self) -> None:
        now = perf_counter()
        level = NOTICE if now - self._said > PATIENCE else logging.INFO
        log.log(level, "Compiling: loop %d, %.0f s since the first", self._n_loops, now - self._began)
        self._said = now if level == NOTICE else self._said

    def on_end(self, event: event.Event) -> None:
        """Nothing to do."""


def _end(helper: subprocess.Popen[bytes]) -> None:
    helper.terminate()
    helper.wait()


FIRST_USE = FirstUse()
event.register("numba:compile", FIRST_USE)  # type: ignore[no-untyped-call]
