# SPDX-License-Identifier: BSD-3-Clause
"""How loops are compiled: at their first use on a machine, then kept in numba's cache.

A newcomer waits for that before the first answer, so it must be short. One signature per loop: one type and memory
layout per argument. No exceptions, strings, `numpy.linalg`, slices or array expressions inside: each drags more of
numba's library through the compiler than the loop itself.
"""

import logging

from numba import njit
from numba.core import event

log = logging.getLogger(__name__)
# Above information and below a warning: to be told at once.
NOTICE = 25

# The numpy error model: a division by 0 gives infinity, and nothing can be raised.
compiled = njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
# Becomes part of the loop that calls it before that is compiled, so that counts known there are known here.
inlined = njit(cache=True, nogil=True, error_model="numpy", inline="always")


class _Announcement(event.Listener):
    """Says why it takes longer, before the first loop is compiled that is not in the cache."""

    def __init__(self) -> None:
        self._is_made = False

    def on_start(self, event: event.Event) -> None:
        """Hear of a compilation."""
        if not self._is_made and event.data["dispatcher"].py_func.__module__.startswith("magmatch."):
            self._is_made = True
            log.log(
                NOTICE,
                "Compiling numerical loops for this machine: once after installation or upgrade, for several seconds",
            )

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""


event.register("numba:compile", _Announcement())
