# SPDX-License-Identifier: BSD-3-Clause
"""The pose of the magnetometer on the body whose poses are given: seven numbers, or a YAML file that holds them."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.tables.number_marks import number_of_text
from magmatch.data.tables.table import MAX_NORM_ERROR
from magmatch.data.tables.text import read_bytes
from magmatch.data.tables.yaml_text import mapping_in, read_yaml
from magmatch.errors import ConfigurationError, DataFormatError

EXPECTED = "x y z qx qy qz qw (m; takes sensor coordinates to body coordinates)"


def read_extrinsic(text: str) -> RigidTransform:
    """Extrinsic of a magnetometer.

    Examples
    --------
    >>> read_extrinsic("0.1 0 0.3").translation.tolist()
    [0.1, 0.0, 0.3]
    """
    try:
        numbers = [number_of_text(word) for word in text.replace(",", " ").split()]
    except ValueError:
        path = Path(text)
        numbers = _from_yaml(path)
        if problem := _problem(numbers):
            raise DataFormatError(path, f"expected {EXPECTED}; {problem}") from None
    if problem := _problem(numbers):
        msg = f"--extrinsic: expected {EXPECTED} or the name of a YAML file; {problem}"
        raise ConfigurationError(msg)
    turn = Rotation.from_quat(numbers[3:]) if len(numbers) == 7 else Rotation.identity()
    return RigidTransform.from_components(numbers[:3], turn)


def _from_yaml(path: Path) -> list[float]:
    """Translation and rotation that a file names, by axes or as lists."""
    content = mapping_in(read_yaml(path, read_bytes(path), "; expected the extrinsic of the magnetometer"))
    content, numbers = content.get("transform", content), []
    try:
        for key, axes in (("translation", "xyz"), ("rotation", "xyzw")):
            part = content[key]
            values = [part[axis] for axis in axes] if isinstance(part, dict) else part
            numbers += [float(value) for value, _ in zip(values, axes, strict=True)]
    except (KeyError, TypeError, ValueError):
        message = "expected translation: {x, y, z} and rotation: {x, y, z, w}, or lists of 3 and 4 numbers"
        raise DataFormatError(path, message) from None
    return numbers


def _problem(numbers: list[float]) -> str:
    """Say what is wrong with numbers that should be three or seven; nothing where nothing is."""
    if len(numbers) not in {3, 7}:
        return f"found {len(numbers)} numbers"
    if not np.isfinite(numbers).all():
        return "found NaN or infinity"
    if len(numbers) == 7 and abs(float(np.linalg.norm(numbers[3:])) - 1) > MAX_NORM_ERROR:
        return f"found a quaternion of length {np.linalg.norm(numbers[3:]):.4g}"
    return ""
