# SPDX-License-Identifier: BSD-3-Clause
"""From the JSON of a registration result to its fields: whatever cannot be is refused by key."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.errors import DataFormatError
from magmatch.geometry import transform_from_matrix
from magmatch.registration.parts import Alternative, DegenerateDirection, Links, Status

MAX_LINKS = 300
# Rounding that a covariance from elsewhere may show, relative to its standard deviations (units differ by entry).
COVARIANCE_TOLERANCE = 1e-9
UNIT_TOLERANCE = 1e-6


def fields_of(document: Mapping[str, Any], path: str | Path) -> dict[str, Any]:
    """Fields of a `RegistrationResult` from a document; what a file from elsewhere leaves out takes its default."""
    for key in ("status", "T_base_target"):
        if key not in document:
            raise DataFormatError(path, f"key '{key}' is missing")
    found: dict[str, Any] = {"reason": ""}
    for key, (name, read) in READERS.items():
        if key in document:
            try:
                found[name] = read(document[key])
            except (ValueError, TypeError, KeyError, OverflowError) as error:
                what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
                raise DataFormatError(path, f"key '{key}': {what}") from None
    if (found["T_base_target"] is not None) != (found["status"] is Status.ACCEPTED):
        said = "null" if found["T_base_target"] is None else "given"
        raise DataFormatError(
            path, f"key 'T_base_target': expected a transform exactly where accepted, {said} with '{found['status']}'"
        )
    if found.get("covariance") is not None and found["T_base_target"] is None:
        raise DataFormatError(path, "key 'covariance': expected null where nothing was accepted")
    return found


def _expect(is_so: bool, expected: str, found: Any) -> None:
    if not is_so:
        msg = f"expected {expected}, found {json.dumps(found)[:60]}"
        raise ValueError(msg)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _status(value: Any) -> Status:
    known = [s.value for s in Status]
    _expect(value in known, "one of " + ", ".join(known), value)
    return Status(value)


def _text(value: Any) -> str:
    _expect(isinstance(value, str), "words", value)
    return str(value)


def _count(value: Any) -> int:
    _expect(isinstance(value, int) and not isinstance(value, bool) and value >= 0, "a count", value)
    return int(value)


def _number(value: Any) -> float:
    _expect(_is_number(value), "a number", value)
    return float(value)


def _fraction(value: Any) -> float:
    _expect(_is_number(value) and 0 <= value <= 1, "a number from 0 to 1", value)
    return float(value)


def _mapping(value: Any) -> dict[str, Any]:
    _expect(isinstance(value, dict), "an object", value)
    return dict(value)


def _statistics(value: Any) -> dict[str, float | None]:
    return {name: _or_none(_number)(number) for name, number in _mapping(value).items()}


def _seconds(value: Any) -> dict[str, float]:
    return {stage: math.nan if seconds is None else _number(seconds) for stage, seconds in _mapping(value).items()}


def _or_none(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Accept null besides."""
    return lambda value: None if value is None else read(value)


def _numbers(value: Any, expected: str, *shape: int) -> np.ndarray:
    """Nested lists of numbers, rows of equal length; -1 for any length."""
    flat = value
    for _ in shape[:-1]:
        _expect(isinstance(flat, list) and all(isinstance(row, list) for row in flat), expected, value)
        flat = [number for row in flat for number in row]
    _expect(isinstance(flat, list) and all(map(_is_number, flat)), expected, value)
    try:
        array = np.array(value, dtype=np.float64).reshape(shape)
    except ValueError:
        array = np.zeros(0)
    _expect(array.size == len(flat) and array.shape[1:] == shape[1:], expected, value)
    return array


def _transform(value: Any) -> RigidTransform:
    return transform_from_matrix(_numbers(value, "a 4x4 matrix", 4, 4))


def _covariance(value: Any) -> np.ndarray:
    """6x6, symmetric and positive semidefinite but for rounding."""
    C = _numbers(value, "a 6x6 matrix", 6, 6)
    variance = C.diagonal()
    _expect(bool((variance >= 0).all()), "variances that are not negative", variance.tolist())
    sd = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = C / sd / sd[:, None]
    asymmetry = float(np.abs(correlation - correlation.T).max())
    _expect(asymmetry <= COVARIANCE_TOLERANCE, "a symmetric matrix", value)
    lowest = float(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0])
    _expect(
        lowest >= -COVARIANCE_TOLERANCE, f"a positive semidefinite matrix (lowest eigenvalue {lowest:.1e})", value
    )
    return C


def _alternatives(value: Any) -> tuple[Alternative, ...]:
    _expect(isinstance(value, list), "a list", value)
    return tuple(
        Alternative(
            _transform(_mapping(a)["T_base_target"]),
            _or_none(_fraction)(a.get("probability")),
            _or_none(_text)(a.get("base")),
            _or_none(_number)(a.get("log_odds")),
        )
        for a in value
    )


def _directions(value: Any) -> tuple[DegenerateDirection, ...]:
    _expect(isinstance(value, list), "a list", value)
    directions = []
    for entry in value:
        xi = _numbers(_mapping(entry)["xi"], "6 numbers", 6)
        _expect(abs(float(np.linalg.norm(xi)) - 1) <= UNIT_TOLERANCE, "a unit vector", entry["xi"])
        directions.append(DegenerateDirection(xi, _text(entry["words"])))
    return tuple(directions)


def _sensor(value: Any) -> dict[str, Any]:
    sensor = _mapping(value)
    for side, told in _mapping(sensor.get("calibrated", {})).items():
        _expect(side in {"base", "target"}, "'base' or 'target'", side)
        _number(_mapping(told).get("time_offset"))
        _numbers(told.get("shift"), "3 numbers", 3)
        matrix = _numbers(told.get("matrix"), "3 rows of 3 numbers", 3, 3)
        _expect(0.1 < np.linalg.det(matrix) < 10, "a matrix near the identity", told["matrix"])
    return sensor


def _links(value: Any) -> Links:
    base, target = (_numbers(_mapping(value)[side], "rows of 3 numbers", -1, 3) for side in ("base", "target"))
    _expect(len(base) == len(target) <= MAX_LINKS, f"at most {MAX_LINKS} pairs", [len(base), len(target)])
    return Links(base, target)


def _inputs(value: Any) -> tuple[dict[str, Any], ...]:
    _expect(isinstance(value, list), "a list", value)
    return tuple(map(_mapping, value))


# Key of the file: field of the result, and how to read it.
READERS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "status": ("status", _status),
    "reason": ("reason", _text),
    "base": ("base", _or_none(_text)),
    "T_base_target": ("T_base_target", _or_none(_transform)),
    "covariance": ("covariance", _or_none(_covariance)),
    "probability": ("probability", _or_none(_fraction)),
    "evidence": ("evidence", _statistics),
    "overlap": ("overlap", lambda value: math.nan if value is None else _fraction(value)),
    "alternatives": ("alternatives", _alternatives),
    "degenerate_directions": ("degenerate_directions", _directions),
    "sensor": ("sensor", _or_none(_sensor)),
    "residual": ("residual", _or_none(_number)),
    "fitness": ("fitness", _or_none(_number)),
    "inliers": ("n_inliers", _count),
    "keypoints": ("n_keypoints", _count),
    "correspondences": ("n_correspondences", _count),
    "links": ("links", _links),
    "seconds": ("seconds", _seconds),
    "config": ("config", _mapping),
    "version": ("version", _text),
    "seed": ("seed", _count),
    "inputs": ("inputs", _inputs),
}
