# SPDX-License-Identifier: BSD-3-Clause
"""What is under way, told to whoever asked to follow: one shape of callback for every verb that may take a second."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
# Called with what is under way, and which share of it is done (0 to 1; None where that is not known). It may be
# called from another thread, and what it raises ends the work.
Progress = Callable[[str, float | None], None]

log = logging.getLogger(__name__)
_follower: ContextVar[Progress | None] = ContextVar("follower", default=None)


@contextmanager
def followed(progress: Progress | None) -> Iterator[None]:
    """Tell a callback of all that is under way in the block; None leaves whoever follows already.

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
    """Tell what is under way; a step that begins is logged, too."""
    if not share:
        log.info("%s", what)
    follower = _follower.get()
    if follower is not None:
        follower(what, share)


def counted(what: str, items: Sequence[T]) -> Iterator[T]:
    """Each of some items, telling before it which share of them is done."""
    for k, item in enumerate(items):
        tell(what, k / len(items))
        yield item
