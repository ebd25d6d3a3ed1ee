# SPDX-License-Identifier: BSD-3-Clause
"""Progress reports: one kind of callback for every function that may take longer than a second."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
# Called with the current step and the fraction done (0 to 1; None if unknown). It may be called from another thread,
# and an exception that it raises ends the work.
Progress = Callable[[str, float | None], None]

log = logging.getLogger(__name__)
_follower: ContextVar[Progress | None] = ContextVar("follower", default=None)


@contextmanager
def followed(progress: Progress | None) -> Iterator[None]:
    """Report progress within the block to a callback; None keeps the present one.

    Examples
    --------
    >>> with followed(lambda what, share: print(what, share)):
    ...     for name in counted("reading", ["a", "b"]):
    ...         pass
    reading 0.0
    reading 0.5
    """
    token = _follower.set(_follower.get() if progress is None else progress)
    try:
        yield
    finally:
        _follower.reset(token)


def tell(what: str, share: float | None = None) -> None:
    """Report the current step; the beginning of a step is also logged."""
    if not share:
        log.info("%s", what)
    follower = _follower.get()
    if follower is not None:
        follower(what, share)


def counted(what: str, items: Sequence[T]) -> Iterator[T]:
    """Iterate over items, reporting the fraction done before each."""
    for k, item in enumerate(items):
        tell(what, k / len(items))
        yield item
