# SPDX-License-Identifier: BSD-3-Clause
"""A registration result as JSON and back: no digit lost, no NaN written, changes noticed."""

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.document import read_document
from magmatch.data.fingerprint import hash_survey
from magmatch.data.survey import Survey
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
    """What a result says, in lists, numbers and words: the keys of the file, in its order."""
    base, target = _few_links(result.links)
    document = {
        "schema": SCHEMA,
        "status": result.status.value,
        "reason": result.reason,
        "base": result.base,
        "T_base_target": None if result.T_base_target is None else matrix_of(result.T_base_target),
        "covariance": _finite_or_none(result.covariance),
        "probability": result.probability,
        "evidence": result.evidence,
        "overlap": result.overlap,
        "alternatives": [
            {"T_base_target": matrix_of(a.T_base_target), "probability": a.probability, "log_odds": a.log_odds}
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


def read_result_document(path: str | Path) -> dict[str, Any]:
    """Read a result's document and check its schema and, where it has one, its checksum."""
    return read_document(path, SCHEMA, "registration result", MAX_BYTES)
