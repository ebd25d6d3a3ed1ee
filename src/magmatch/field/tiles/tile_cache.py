# SPDX-License-Identifier: BSD-3-Clause
"""A thread-safe cache of tiles, limited by memory."""

from collections import OrderedDict
from collections.abc import Callable, Iterable
from threading import Lock

import numpy as np

from magmatch.field.spline.spline_model import SplinePosterior

# At 2 MB each without their factor.
MOST_TILES = 64


class TileCache:
    """Keeps some things as they were made, and beside them the last few that were asked for."""

    def __init__(self, n_bytes: float = np.inf) -> None:
        self._n_bytes, self._lock = n_bytes / 2, Lock()
        self._offered: dict[int, SplinePosterior] = {}
        self._made = OrderedDict[int, SplinePosterior]()

    def find(self, number: int, make: Callable[[], SplinePosterior]) -> SplinePosterior:
        """Give what was made under a number, or else make it."""
        with self._lock:
            found = self._offered.get(number) or self._made.get(number)
            if number in self._made:
                self._made.move_to_end(number)
        if found is not None:
            return found
        # Without the lock: others may make theirs meanwhile.
        made = make()
        with self._lock:
            while self._made and self._is_full():
                self._made.popitem(last=False)
            self._made[number] = made
        return made

    def offer(self, number: int, posterior: SplinePosterior) -> None:
        """Keep what was made already, if there is room: whatever is asked in turn finds these at least."""
        with self._lock:
            if _n_bytes([*self._offered.values(), posterior]) <= self._n_bytes:
                self._offered[number] = posterior

    def _is_full(self) -> bool:
        return len(self._made) >= MOST_TILES or _n_bytes(self._made.values()) > self._n_bytes


def _n_bytes(posteriors: Iterable[SplinePosterior]) -> int:
    return sum(posterior.factors.n_bytes for posterior in posteriors)
