# SPDX-License-Identifier: BSD-3-Clause
"""Build magnetic maps, register them, correct odometry drift with them, and localise in them.

Names are resolved on first use, so that importing the package costs nothing until work begins. What is public is
listed in `__init__.pyi`, or in `magmatch.published`, `magmatch.phones`, `magmatch.simulation` or `magmatch.viz`.
"""

import re
from importlib import import_module
from typing import Any

from magmatch._version import __version__ as __version__

# Where each public name lives; the loader reads it in an archive, too.
_LISTING = __loader__.get_data(f"{__path__[0]}/__init__.pyi").decode()
_HOMES = {name: home for home, name in re.findall(r"^from (\S+) import (\w+)", _LISTING, re.MULTILINE)}

__all__ = sorted(_HOMES)  # noqa: PLE0605  (type checkers have the other file)

# One room has the name of its verb. Python names a room here when it is first imported and never again: so that is
# done now, and the name is left to the verb. `from magmatch.slam.x import y` finds the room all the same.
import_module("magmatch.slam")
del globals()["slam"]


# Public rooms beside this one.
_ROOMS = {"phones", "published", "simulation", "viz"}


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"magmatch.{name}")
    if name not in _HOMES:
        msg = f"module 'magmatch' has no attribute '{name}'"
        raise AttributeError(msg)
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__]
