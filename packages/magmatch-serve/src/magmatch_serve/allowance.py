# SPDX-License-Identifier: BSD-3-Clause
"""Something may be had at so much a second, and a few seconds' worth at once."""

from collections import OrderedDict
from collections.abc import Callable
from time import monotonic


class Allowance:
    """A bucket that fills by `rate` a second up to `most`."""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._left, self._at = most, clock()

    def take(self, n: float = 1.0) -> float:
        """Take so much; gives the seconds to wait until it was there, 0 where it is."""
        now = self._clock()
        self._left, self._at = min(self._left + (now - self._at) * self._rate, self._most) - n, now
        return max(-self._left / self._rate, 0.0)

    def give_back(self, n: float = 1.0) -> None:
        """Return what was not used."""
        self._left += n


class Allowances:
    """An allowance for each address; only the `most_known` that were heard of last are known."""

    def __init__(self, per_minute: float, most_known: int = 10_000, clock: Callable[[], float] = monotonic) -> None:
        self._per_minute, self._most_known, self._clock = per_minute, most_known, clock
        self._known: OrderedDict[str, Allowance] = OrderedDict()

    def take(self, address: str) -> float:
        """Seconds until this address may come again; 0: it may now."""
        one = self._known.pop(address, None) or Allowance(self._per_minute / 60, self._per_minute / 6, self._clock)
        self._known[address] = one
        if len(self._known) > self._most_known:
            self._known.popitem(last=False)
        wait = one.take()
        if wait > 0:
            one.give_back()
        return wait
