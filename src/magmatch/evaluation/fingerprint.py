# SPDX-License-Identifier: BSD-3-Clause
"""What tells rows of other settings or other code from one's own: they are never taken for today's."""

import hashlib
from functools import cache
from pathlib import Path

import magmatch

# Rooms that show and drive but do not compute.
WITHOUT_INFLUENCE = ("cli", "viz", "evaluation")


def fingerprint(*settings: str) -> str:
    """Short digest of settings and of all code that results depend on.

    Parameters
    ----------
    *settings : str

    Returns
    -------
    str
        16 hex digits.
    """
    return hashlib.sha256("\0".join([*settings, code_digest()]).encode()).hexdigest()[:16]


@cache
def code_digest() -> str:
    """Digest of the package's source, but for the rooms that only show and drive."""
    package, digest = Path(magmatch.__file__).parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        place = path.relative_to(package)
        if place.parts[0] not in WITHOUT_INFLUENCE:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
