# SPDX-License-Identifier: BSD-3-Clause
"""A hash of a survey's content, to tell later whether it is still the same."""

import hashlib

import numpy as np

from magmatch.data.survey import Survey


def hash_survey(survey: Survey) -> str:
    """SHA-256 of a survey's samples, whatever file they came from; its name and that of its frame do not count.

    Positions, field, times and ``pose_sd`` count to the last bit. Orientations count as float32, either sign:
    reading quaternions from text brings them to unit length once more, which changes their last bits.

    Examples
    --------
    >>> import numpy as np
    >>> hash_survey(Survey(np.zeros((1, 3)), np.full((1, 3), 1e-5)))[:8]
    '737c5ed9'
    """
    digest = hashlib.sha256(b"magmatch.survey/1")
    parts: dict[str, np.ndarray] = {"positions": survey.positions, "field": survey.field}
    if survey.times is not None:
        parts["times"] = survey.times
    if survey.orientations is not None:
        parts["orientations"] = survey.orientations.as_quat(canonical=True)
    parts["pose_sd"] = np.array([survey.pose_sd])
    for name, values in parts.items():
        # Adding zero takes the sign off negative zeros, which text need not keep.
        kind = "<f4" if name == "orientations" else "<f8"
        block = values.astype(kind) + 0.0
        digest.update(f"{name} {block.shape} {kind};".encode() + block.astype(kind, copy=False).tobytes())
    return digest.hexdigest()


def describe_input(survey: Survey) -> dict[str, str]:
    """Name and SHA-256 of a survey, for a result's ``inputs``."""
    return {"name": survey.name, "sha256": hash_survey(survey)}
