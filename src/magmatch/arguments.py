# SPDX-License-Identifier: BSD-3-Clause
"""Arguments of public functions: made float64 arrays, or refused in one sentence, before compiled code runs."""

import os
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.number_text import told
from magmatch.typing import Points, Scalars

_TO_NUMBERS = "turn it into numbers first (pandas: to_numeric, of times to_datetime)"
_COMMAS = "turn it into numbers first (pandas: read_csv with decimal=',' or with thousands=',')"
# What arrays of other kinds are, and what to do about it.
_OTHERS = {
    "b": ("booleans", "convert it to float64 first"),
    "c": ("complex numbers", "take the real part"),
    "M": ("dates", "turn them into seconds: (t - t[0]) / np.timedelta64(1, 's')"),
    "m": ("time differences", "divide them by np.timedelta64(1, 's')"),
    **dict.fromkeys("STU", ("text", _TO_NUMBERS)),
}


def numbers_of(values: Any, name: str, shape: str) -> np.ndarray:
    """Native float64 of anything that holds plain real numbers; their shape is only stated, in messages."""
    if type(values) is np.ndarray and values.dtype == np.float64 and values.dtype.isnative:
        return np.asarray(values, order="C")  # sums of rows depend on their order in memory
    expected = f"one number{shape[2:]}" if shape.startswith("()") else f"numbers of shape {shape}"
    # Of pint, astropy and xarray; a table of pandas has columns, of whatever name.
    unit = next((getattr(values, n) for n in ("units", "unit") if hasattr(values, n)), None)
    if unit is not None and not hasattr(values, "columns"):
        _refuse(
            name, f"plain {expected}", f"a {type(values).__name__} with the unit {str(unit)[:20]}", "convert it first"
        )
    if np.ma.is_masked(values):
        _refuse(name, expected, "masked values", "leave them out")
    try:
        array = _as_array(values)
    except Exception:  # whatever another library's array raises when it is asked for numbers
        _refuse(name, expected, f"a {type(values).__name__} that is no table of numbers", "give rows of equal length")
    if array.dtype.kind not in "iuf":
        unknown = f"{found(values)} of dtype {array.dtype}", "convert it to float64 first"
        kind, advice = _OTHERS.get(array.dtype.kind, unknown)
        if values is None:
            _refuse(name, expected, "None", "")
        text = next((cell for cell in array.flat if isinstance(cell, str)), None)
        if hasattr(values, "positions"):
            advice = "give its .positions"
        elif text is not None and array.dtype == object:
            kind, advice = f"text such as {found(text)}", _COMMAS if "," in text else _TO_NUMBERS
        _refuse(name, expected, kind, advice)
    with np.errstate(over="ignore"):
        return np.asarray(array, dtype=np.float64, order="C")


def points_of(values: Any, name: str = "points", unit: str = "m", thing: str = "row") -> Points:
    """Finite numbers in rows of three: (n, 3), whatever array, table or list they came in; rows go by position.

    ``name``, ``unit`` and ``thing`` (what a row is) are for the `ValueError` of anything else.
    """
    array = numbers_of(values, name, f"(n, 3), in {unit}")
    if array.ndim != 2 or array.shape[1] != 3:
        advice = "give one row of x, y, z for each"
        if array.shape == (3,):
            advice = f"write one {thing} as [[x, y, z]]"
        elif array.ndim == 2 and array.shape[0] == 3:
            advice = "transpose it"
        _refuse(name, f"shape (n, 3), in {unit}", f"shape {array.shape}", advice)
    require_finite(array, name, thing)
    return array


def column_of(values: Any, name: str, unit: str, n: int, thing: str = "sample") -> Scalars:
    """Finite numbers, one for each of n samples: (n,)."""
    array = numbers_of(values, name, f"({n},), in {unit}")
    if array.shape != (n,):
        _refuse(name, f"one number for each of {n} {thing}s, in {unit}", f"shape {array.shape}", "give as many")
    require_finite(array, name, thing)
    return array


def number_of(value: Any, name: str, unit: str, *, is_positive: bool = False) -> float:
    """One finite number that is not negative (or: positive)."""
    expected = f"a {'positive' if is_positive else 'non-negative'} number{unit and f', in {unit}'}"
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        _refuse(name, expected, found(value), "", TypeError)
    if not (0 < value < np.inf or (value == 0 and not is_positive)):
        _refuse(name, expected, f"{value}", "choose another")
    return float(value)


def whole_number_of(value: Any, name: str, least: int = 0, most: int | None = None) -> int:
    """A whole number within bounds."""
    expected = f"a whole number from {least}{'' if most is None else f' to {most}'}"
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        _refuse(name, expected, found(value), "", TypeError)
    if value < least or (most is not None and value > most):
        _refuse(name, expected, f"{value}", "choose another")
    return int(value)


def rows_chosen(rows: Any, n: int) -> np.ndarray:
    """A mask over n samples, or indices or a slice of some of them."""
    array = np.arange(n)[rows] if isinstance(rows, slice) else np.asarray(rows)
    if array.size == 0 and array.ndim == 1:
        return array.astype(np.int64)
    is_mask = array.dtype == np.bool_ and array.shape == (n,)
    if is_mask or (array.ndim == 1 and array.dtype.kind in "iu" and -n <= array.min() and array.max() < n):
        return array
    return _refuse("rows", f"a mask (n,) or indices of {n} samples", found(rows), "rows count from 0")


def expect_kind(value: Any, name: str, kinds: tuple[type, ...], advice: Mapping[str, str] | str = "") -> None:
    """Raise TypeError unless a value is of one of these classes; advice may depend on what was found."""
    if not isinstance(value, kinds):
        if not isinstance(advice, str):
            advice = advice.get(kind_of(value), advice.get("", ""))
        expected = " or ".join(kind.__name__ for kind in kinds)
        _refuse(name, expected, found(value), advice, TypeError)


def expect_path(value: Any, name: str = "path") -> None:
    """Raise TypeError unless this is the path of a file or folder."""
    if not isinstance(value, str | os.PathLike):
        _refuse(name, "the path of a file", found(value), "", TypeError)


def expect_transform(value: Any, name: str) -> None:
    """Raise unless this is one rigid motion."""
    expect_kind(value, name, (RigidTransform,), "RigidTransform.from_matrix makes one of a 4x4 matrix (SciPy)")
    if not value.single:
        _refuse(name, "one RigidTransform", f"{len(value)} of them", "take one")


def expect_rotations(value: Any, name: str, n: int, thing: str = "sample") -> None:
    """Raise unless this is one rotation for each of n samples."""
    expect_kind(value, name, (Rotation,), "Rotation.from_quat makes one of quaternions x, y, z, w (SciPy)")
    if value.single or len(value) != n:
        got = "a single one" if value.single else f"{len(value)}"
        _refuse(name, f"one rotation for each of {n} {thing}s", got, "give as many")


def require_finite(array: np.ndarray, name: str, thing: str = "sample") -> None:
    """Raise ValueError where rows hold NaN or infinity, naming the first."""
    if np.isfinite(array).all():
        return
    wrong = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
    where = f"{len(wrong)} of {len(array)} {thing}s, first in {thing} {wrong[0]}"
    msg = f"expected finite {name}, got NaN or infinity in {where}; leave such {thing}s out"
    raise ValueError(msg)


def require_increasing(times: Scalars, thing: str = "sample") -> None:
    """Raise ValueError at the first time (s) that does not come after the one before it."""
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if len(wrong):
        i = int(wrong[0]) + 1
        kind = "repeats" if times[i] == times[i - 1] else "runs backward"
        order = f"{told(times[i])} after {told(times[i - 1])} s"
        msg = f"time {kind} at {thing} {i}: {order}; expected strictly increasing times"
        raise ValueError(msg)


def found(value: Any) -> str:
    """Say in a few words what a value is.

    Examples
    --------
    >>> found(np.zeros((3, 2))), found("room.csv"), found(None)
    ('an array of shape (3, 2)', "'room.csv'", 'None')
    """
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if value is None or isinstance(value, str | bytes | int | float | complex | os.PathLike):
        text = repr(os.fspath(value)) if isinstance(value, os.PathLike) else repr(value)
        return text if len(text) <= 60 else f"{text[:57]}..."
    return f"a {type(value).__name__}"


def kind_of(value: Any) -> str:
    """Name the kind of a value for advice: 'path', 'array', 'list of' some class, or the name of its class."""
    if isinstance(value, str | os.PathLike):
        return "path"
    first = type(value[0]).__name__ if isinstance(value, list | tuple) and value else ""
    if first == "Survey":
        return f"list of {first}"
    return "array" if isinstance(value, np.ndarray | list | tuple) else type(value).__name__


def _as_array(values: Any) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype == object and hasattr(values, "to_numpy"):
        # Nullable columns of pandas: numbers, where NA stands for NaN.
        kinds = values.dtypes if np.ndim(values) == 2 else [values.dtype]
        if all(getattr(kind, "kind", "O") in "iuf" for kind in kinds):
            return np.asarray(values.to_numpy(dtype=np.float64, na_value=np.nan))
    return array


def _refuse(name: str, expected: str, got: str, advice: str, kind: type[Exception] = ValueError) -> NoReturn:
    msg = f"{name}: expected {expected}, got {got}{advice and f'; {advice}'}"
    raise kind(msg)
