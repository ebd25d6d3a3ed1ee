# SPDX-License-Identifier: BSD-3-Clause
"""The last look at a correction: whether it leaves a field that the readings can be of. If not, nothing is written.

What a sensor adds turns with it, so it makes the field and its magnitude vary with the attitude. A right correction
takes that off: neither varies more along the path than as read. Magnitudes need no attitude, so wrong poses cannot
make a wrong correction look right. What is allowed beyond is what soft iron may be at most.
"""

import numpy as np

from magmatch.data.units import ORDINARY_FIELD, field_text
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.typing import Vectors

# Soft iron and unequal gains are 5 % or so. At six times that the weakest axis still has two thirds of its gain, far
# from a singular matrix, under which any field is consistent.
MOST_SOFT_IRON = 0.3
# rad: beyond, a misalignment is not linear enough.
MOST_TURN = 0.6
# Share of the field that noise may add to its spread.
NOISE = 0.01


def why_no_sensor(model: SensorCorrection) -> str:
    """Say why no sensor has such errors; nothing where one may."""
    # Rotations aside: stretches of a matrix without a common scale.
    stretch = np.linalg.svd(model.matrix, compute_uv=False)
    worst = float(np.abs(stretch - 1).max())
    if worst > MOST_SOFT_IRON:
        return f"a soft iron of {worst:.0%} is more than the {MOST_SOFT_IRON:.0%} that a sensor that works may have"
    turn = float(np.linalg.norm(model.misalignment))
    if turn > MOST_TURN:
        most = f"{np.degrees(MOST_TURN):.0f} deg"
        return (
            f"a misalignment of {np.degrees(turn):.0f} deg is more than the {most} that can be told: state the axes"
        )
    return ""


def why_no_field(as_read: Vectors, corrected: Vectors) -> str:
    """Say why a corrected field, (n, 3), T, survey frame, is none that the readings can be of; else nothing."""
    read, left = np.linalg.norm(as_read, axis=1), np.linalg.norm(corrected, axis=1)
    median = float(np.median(read)), float(np.median(left))
    low, high = ORDINARY_FIELD
    if low <= median[0] <= high and not low <= median[1] <= high:
        return f"the median magnitude would go from {field_text(median[0])} to {field_text(median[1])}"
    spreads = {"the magnitude": (read.std(), left.std())}
    spreads["the field"] = np.sqrt(as_read.var(axis=0).sum()), np.sqrt(corrected.var(axis=0).sum())
    for name, (before, after) in spreads.items():
        if after > np.hypot((1 + MOST_SOFT_IRON) * before, NOISE * median[0]):
            spread = f"from {field_text(float(before))} to {field_text(float(after))}"
            return (
                f"{name} would vary more along the path, {spread}: errors of a sensor make it vary, not their removal"
            )
    return ""
