# SPDX-License-Identifier: BSD-3-Clause
"""Functions run on tasks, here or by other processes, whose results are found once and kept on disk where asked.

    with Runner(workers, keep=folder, kinds=(Match,)) as run:
        for result in run(compare, tasks, "comparing windows"): ...

A result depends on the arguments of its task alone. So it is the same to the bit wherever and in whatever order tasks
run, and the SHA-256 of function, arguments and program stands for it: a run that was cut off finds what it kept by
that, and an input that has changed finds nothing.
"""

import copyreg
import hashlib
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cache, cached_property, partial
from itertools import chain, islice, tee
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any, Generic, Self, TypeVar

import numpy as np
from pydantic import BaseModel
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch._version import __version__
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.progress import tell
from magmatch.store import Kinds, load, save, saved_fields
from magmatch.threads import side_by_side
from magmatch.workers import Task

log = logging.getLogger(__name__)

SCHEMA, ENDING = "magmatch.results/1", ".results"
# Seconds of work that a power cut may cost.
KEEP_EVERY_S = 5.0
# Tasks for which this process makes what they share at once.
AT_ONCE = 32
# Tasks that one process had better do, as it has what they share; of more at once, other processes make it too.
MOST_TOGETHER = 16
# What a process keeps of shared arguments, by their size in samples: of maps, at about six kilobytes a sample.
MOST_SHARED = 250_000
T = TypeVar("T")
R = TypeVar("R")
# Applies a function to each of some tasks, in other processes; results in the order of the tasks.
Workers = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True, eq=False)
class Shared(Generic[T]):
    """An argument of many tasks, sent as what it is made of: each process that needs it makes it once."""

    make: Callable[..., T]
    arguments: tuple[Any, ...]
    size: int  # samples

    @cached_property
    def key(self) -> str:
        """SHA-256 that stands for it."""
        return key_of(self.make, self.arguments)

    def __getstate__(self) -> dict[str, Any]:
        # Who receives it knows it by its key, which is computed once.
        return self.__dict__ | {"key": self.key}


class Runner:
    """Runs a function on tasks; a context manager that keeps the last results on leaving."""

    def __init__(self, workers: Workers | None = None, keep: str | Path | None = None, kinds: Kinds = ()) -> None:
        """``keep``: folder for results, created where needed; ``kinds``: classes that occur in what is kept."""
        if workers is not None and not callable(workers):
            msg = f"run: expected a callable such as magmatch.DaskRunner, got {workers!r:.40}"
            raise TypeError(msg)
        self._workers, self._shelf, self._affinities = workers, Shelf(), dict[tuple[str, int], int]()
        self._memo = None if keep is None else Memo(Path(keep), kinds)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._memo is not None:
            self._memo.write()

    def __call__(
        self, function: Callable[..., R], tasks: Iterable[Task], what: str | None = None, *, keep: bool = True
    ) -> Iterator[R]:
        """Give the result of each task, in the order of the tasks.

        ``what``: tells progress in these words, for a sequence of tasks; ``keep=False``: nothing of it goes to disk.
        """
        memo = self._memo if keep else None
        asked, answered = tee(self._looked_up(function, tasks, memo))
        execute = self._here if self._workers is None else self._elsewhere
        new = execute(function, (task for task, _, is_known in asked if not is_known))
        for k, (_, key, is_known) in enumerate(answered):
            if what is not None and isinstance(tasks, Sequence):
                tell(what, k / len(tasks))
            result = memo.known[key] if memo is not None and is_known else next(new)
            if memo is not None and not is_known:
                memo.add(key, result)
            yield result

    def _looked_up(
        self, function: Callable[..., R], tasks: Iterable[Task], memo: "Memo | None"
    ) -> Iterator[tuple[Task, str, bool]]:
        """Each task with its key, and whether its result is known."""
        for task in tasks:
            key = "" if memo is None else key_of(function, task.arguments)
            yield task, key, memo is not None and key in memo.known

    def _here(self, function: Callable[..., R], tasks: Iterator[Task]) -> Iterator[R]:
        # Not by threads: most functions hold the interpreter so often that two at once take longer than in turn.
        while some := list(islice(tasks, AT_ONCE)):
            made = self._shelf.take(_shared_by(some))
            for task in some:
                yield function(*_given(task, made))

    def _elsewhere(self, function: Callable[..., R], tasks: Iterator[Task]) -> Iterator[R]:
        assert self._workers is not None
        n_before = Counter[str]()
        # Workers are started for the first task, not for none.
        for first in tasks:
            sent = (replace(task, affinity=self._affinity(task, n_before)) for task in chain([first], tasks))
            yield from self._workers(partial(_run, function), sent)

    def _affinity(self, task: Task, n_before: Counter[str]) -> int | None:
        """Some tasks that share an argument have one number: by the order in which these were first asked for."""
        key = next((one.key for one in _shared_by([task])), None)
        if key is None:
            return None
        n_before[key] += 1
        part = key, (n_before[key] - 1) // MOST_TOGETHER
        return self._affinities.setdefault(part, len(self._affinities))


class Shelf:
    """Shared arguments that were made in this process; those used longest ago are given up first."""

    def __init__(self) -> None:
        self._made: dict[str, tuple[int, Any]] = {}
        self._lock = Lock()

    def take(self, shared: Iterable[Shared[Any]]) -> dict[str, Any]:
        """Each by its key; those that are not there are made, side by side."""
        asked = {one.key: one for one in shared}
        with self._lock:
            found = {key: self._made.pop(key) for key in asked if key in self._made}
        new = [one for key, one in asked.items() if key not in found]
        for one, made in zip(new, side_by_side(_made, new), strict=True):
            found[one.key] = one.size, made
        with self._lock:
            # Those used last stand last.
            self._made = {key: one for key, one in self._made.items() if key not in found} | found
            while len(self._made) > len(found) and sum(size for size, _ in self._made.values()) > MOST_SHARED:
                del self._made[next(iter(self._made))]
        return {key: made for key, (_, made) in found.items()}


class Memo:
    """Results on disk, by the keys of their tasks; what is damaged or of something else is not believed."""

    def __init__(self, folder: Path, kinds: Kinds) -> None:
        if not folder.resolve().parent.is_dir():
            msg = f"keep: the folder {folder.resolve().parent} does not exist; create it first"
            raise ConfigurationError(msg)
        if folder.exists() and not folder.is_dir():
            msg = f"keep: {folder} is a file, expected the name of a folder"
            raise ConfigurationError(msg)
        self.folder, self.known, self._new = folder, dict[str, Any](), dict[str, Any]()
        files = sorted(folder.glob(f"*{ENDING}"))
        for path in files:
            try:
                self.known |= load(path, SCHEMA, kinds)
            except DataFormatError as error:
                log.info("%s", error)
        self._n_files, self._written = len(files), monotonic()
        if self.known:
            log.info("going on with %d results that were kept in %s", len(self.known), folder)

    def add(self, key: str, result: Any) -> None:
        """Keep one more result; it goes to disk with others, every few seconds."""
        self.known[key] = self._new[key] = result
        if monotonic() - self._written > KEEP_EVERY_S:
            self.write()

    def write(self) -> None:
        """Write what was found since the last time."""
        if not self._new:
            return
        self.folder.mkdir(exist_ok=True)
        while (path := self.folder / f"{self._n_files}{ENDING}").exists():
            self._n_files += 1
        save(path, SCHEMA, self._new)
        self._new, self._written = {}, monotonic()


def key_of(function: Callable[..., Any], arguments: Sequence[Any]) -> str:
    """SHA-256 of a function's name, the content of its arguments, and the program."""
    digest = hashlib.sha256(program().encode())
    _feed(digest, (function, *arguments))
    return digest.hexdigest()


@cache
def program() -> str:
    """SHA-256 of the program's version and text: whatever is changed in it may change what it finds."""
    texts = sorted(path.read_bytes() for path in Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join([__version__.encode(), *texts])).hexdigest()


# What stands for values of some kinds.
_CONTENT: tuple[tuple[type, Callable[[Any], Any]], ...] = (
    (Shared, lambda one: one.key),
    (RigidTransform, RigidTransform.as_matrix),
    (Rotation, Rotation.as_quat),
    (BaseModel, BaseModel.model_dump_json),
    (np.generic, np.generic.item),
    (Mapping, lambda one: sorted(one.items())),
)


def _feed(digest: Any, value: Any) -> None:
    """Hash a value by its content: however it was made and wherever it lies, equal values are fed equally."""
    content = next((of for kind, of in _CONTENT if isinstance(value, kind)), None)
    if content is not None:
        _feed(digest, content(value))
        return
    match value:
        case np.ndarray():
            digest.update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
        case tuple() | list():
            digest.update(f"{len(value)}:".encode())
            for each in value:
                _feed(digest, each)
        case None | str() | bytes() | bool() | int() | float():
            digest.update(f"{value!r};".encode())
        case _ if callable(value):
            digest.update(f"{value.__module__}.{value.__qualname__};".encode())
        case _ if hasattr(value, "follows_from"):
            _feed(digest, value.follows_from)
        case _ if is_dataclass(value):
            _feed(digest, [type(value).__name__, *(getattr(value, name) for name in saved_fields(value))])
        case _:
            msg = f"expected arguments of numbers, words, arrays or dataclasses of them, got {type(value).__name__}"
            raise TypeError(msg)


def _shared_by(tasks: Iterable[Task]) -> list[Shared[Any]]:
    return [one for task in tasks for one in task.arguments if isinstance(one, Shared)]


def _given(task: Task, made: Mapping[str, Any]) -> list[Any]:
    """Arguments of a task, the shared ones as they were made."""
    return [made[one.key] if isinstance(one, Shared) else one for one in task.arguments]


def _made(shared: Shared[T]) -> T:
    return shared.make(*shared.arguments)


# What this process has made for tasks that other processes sent.
_shelf = Shelf()


def _run(function: Callable[..., R], task: Task) -> R:
    return function(*_given(task, _shelf.take(_shared_by([task]))))


# SciPy brings a rigid transform to the nearest one whenever it is unpickled; a task is sent to the bit.
copyreg.pickle(RigidTransform, lambda T: (partial(RigidTransform, normalize=False), (T.as_matrix(),)))  # type: ignore[arg-type]
