# SPDX-License-Identifier: BSD-3-Clause
"""A registration result as JSON and back: no digit lost, no NaN written, changes noticed."""

import hashlib
import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.atomic import atomic_write
from magmatch.data.fingerprint import hash_survey
from magmatch.data.survey import Survey
from magmatch.data.text import read_bytes
from magmatch.errors import DataFormatError
from magmatch.geometry import transform_from_matrix
from magmatch.registration.parts import Links
from magmatch.registration.validation import MAX_LINKS

if TYPE_CHECKING:
    from magmatch.registration.result import RegistrationResult

SCHEMA = "magmatch.registration/1"
MAX_BYTES = 64 * 1024**2


def describe_input(survey: Survey) -> dict[str, str]:
    """Name and SHA-256 of a survey, for the result's ``inputs``."""
    return {"name": survey.name, "sha256": hash_survey(survey)}


def document_of(result: "RegistrationResult") -> dict[str, Any]:
    """What a result says, in lists, numbers and words: the keys of the file, in its order.

    Parameters
    ----------
    result : RegistrationResult

    Returns
    -------
    dict
        Numbers that are not finite are None.
    """
    base, target = _few_links(result.links)
    document = {
        "schema": SCHEMA,
        "status": result.status.value,
        "reason": result.reason,
        "base": result.base,
        "T_base_target": None if result.T_base_target is None else matrix_of(result.T_base_target),
        "covariance": _finite_or_none(result.covariance),
        "probability": result.probability,
        "overlap": result.overlap,
        "alternatives": [
            {"T_base_target": matrix_of(a.T_base_target), "probability": a.probability}
            | ({} if a.base is None else {"base": a.base})
            for a in result.alternatives
        ],
        "degenerate_directions": [{"xi": d.xi, "words": d.words} for d in result.degenerate_directions],
        "sensor": result.sensor,
        "residual": result.residual,
        "fitness": result.fitness,
        "inliers": result.n_inliers,
        "keypoints": result.n_keypoints,
        "correspondences": result.n_correspondences,
        "links": {"base": base, "target": target},
        "seconds": result.seconds,
        "config": result.config,
        "version": result.version,
        "seed": result.seed,
        "inputs": result.inputs,
    }
    return {key: _plain(value, key) for key, value in document.items()}


def matrix_of(T: RigidTransform) -> list[list[float]]:
    """4x4 numbers that `transform_from_matrix` takes back to the same bits."""
    matrix: list[list[float]] = transform_from_matrix(T.as_matrix()).as_matrix().tolist()
    return matrix


def _few_links(links: Links) -> tuple[np.ndarray, np.ndarray]:
    """At most `MAX_LINKS` finite pairs, evenly chosen; few enough to stay as they are next time."""
    rows = np.flatnonzero(np.isfinite(links.base).all(axis=1) & np.isfinite(links.target).all(axis=1))
    rows = rows[np.linspace(0, len(rows) - 1, min(MAX_LINKS, len(rows))).astype(int)]
    return links.base[rows], links.target[rows]


def _finite_or_none(values: np.ndarray | None) -> np.ndarray | None:
    return values if values is not None and np.isfinite(values).all() else None


def _plain(value: Any, key: str) -> Any:
    """Only what JSON knows: numbers of NumPy become Python's, what is not finite becomes None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    elif isinstance(value, Enum | Path):
        value = value.value if isinstance(value, Enum) else str(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{key}.{k}") for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v, key) for v in value]
    if value is not None and not isinstance(value, bool | int | float | str):
        msg = f"'{key}' holds a {type(value).__name__}, expected numbers, words, lists or mappings"
        raise TypeError(msg)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: str | Path, document: Mapping[str, Any]) -> None:
    """Write a document with its checksum, one key a line, whole or not at all.

    Parameters
    ----------
    path : path
        Where; an existing file is replaced.
    document : mapping
        Of `document_of`.
    """
    lines = [f'  "{key}": {json.dumps(value, allow_nan=False)}' for key, value in document.items()]
    lines.append(f'  "checksum": "{checksum(document)}"')
    with atomic_write(path) as stream:
        stream.write(("{\n" + ",\n".join(lines) + "\n}\n").encode())


def checksum(document: Mapping[str, Any]) -> str:
    """SHA-256 of what a document says, whatever the order and layout of its keys and ``1`` or ``1.0``."""
    rest = {key: _canonical(value) for key, value in document.items() if key != "checksum"}
    text = json.dumps(rest, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _canonical(v) for key, v in value.items()}
    if isinstance(value, list):
        return [_canonical(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 2**53 else value


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a document and check its schema and, where it has one, its checksum.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    dict

    Raises
    ------
    DataFormatError
        No such file, not JSON, another schema, or changed after it was written.
    """
    content = read_bytes(path, MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise DataFormatError(path, f"is larger than any registration result ({MAX_BYTES} bytes)")
    try:
        text = content.decode("utf-8-sig")
        document = json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse, parse_float=_finite)
        # Files from elsewhere need not have a checksum.
        is_changed = isinstance(document, dict) and document.get("checksum") not in (None, checksum(document))
    except (ValueError, RecursionError) as error:
        raise DataFormatError(path, f"is not a registration result (JSON): {error}") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if not isinstance(document, dict) or schema != SCHEMA:
        is_newer = isinstance(schema, str) and schema.startswith(SCHEMA.rpartition("/")[0] + "/")
        advice = "; it was written by another version of magmatch: update, or register again" if is_newer else ""
        raise DataFormatError(path, f"key 'schema': expected '{SCHEMA}', found {schema!r}{advice}")
    if is_changed:
        raise DataFormatError(
            path,
            "key 'checksum': the file was changed after it was written; register again, or delete the key "
            "'checksum' if the change is meant",
        )
    return document


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse an object that says one thing twice: readers differ in which they believe."""
    made = dict(pairs)
    if len(made) < len(pairs):
        msg = f"one of the keys {sorted(made)[:5]} appears twice"
        raise ValueError(msg)
    return made


def _refuse(constant: str) -> float:
    msg = f"{constant} is not a JSON number"
    raise ValueError(msg)


def _finite(text: str) -> float:
    """Refuse a number that only infinity could stand for."""
    value = float(text)
    return value if math.isfinite(value) else _refuse(text[:40])
