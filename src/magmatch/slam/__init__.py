# SPDX-License-Identifier: BSD-3-Clause
"""Logs whose poses drift, corrected and in one frame: loop closures between stretches of path at the same place."""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magmatch.slam.session import Session


class _Room(ModuleType):
    """A room that is called as its verb: once imported, ``magmatch.slam`` is the room and not the function."""

    def __call__(self, *args: Any, **kwargs: Any) -> "Session":
        """Correct drift: see `magmatch.slam.run.slam`."""
        from magmatch.slam.run import slam

        return slam(*args, **kwargs)


sys.modules[__name__].__class__ = _Room
