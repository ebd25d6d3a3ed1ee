# SPDX-License-Identifier: BSD-3-Clause
"""Values in one line: what a console shows of an object that holds thousands of numbers."""

from collections.abc import Sized
from dataclasses import fields
from numbers import Number
from pathlib import Path
from typing import Any

import numpy as np

# Characters of one text, and items of a sequence, that are shown.
LONGEST, MOST = 60, 3


def brief(noun: Any) -> str:
    """Name and fields of a dataclass in one line, arrays by their shapes; for use as its ``__repr__``.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Walk:
    ...     times: np.ndarray
    ...     name: str
    ...     __repr__ = brief
    >>> Walk(np.zeros(1000), "hall")
    Walk: times (1000,), name 'hall'
    """
    said = ((f.name, getattr(noun, f.name)) for f in fields(noun) if f.repr)
    return (
        f"{type(noun).__name__}: {', '.join(f'{name} {_words(value)}' for name, value in said if value is not None)}"
    )


def _words(value: Any) -> str:
    kind = type(value).__name__
    match value:
        case np.ndarray():
            return str(value.shape)
        case str() | Path():
            text = repr(str(value))
            return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]}...'"
        case bool() | Number():
            return f"{value:.6g}" if isinstance(value, float) else str(value)
        case tuple() if len(value) <= MOST and all(isinstance(item, str | Number) for item in value):
            return f"({', '.join(map(_words, value))})"
        case list() | tuple() if value:
            kind = f"{len(value)} of {type(value[0]).__name__}"
        case Sized() if not getattr(value, "single", False):
            kind = f"{kind} of {len(value)}"
    return kind
