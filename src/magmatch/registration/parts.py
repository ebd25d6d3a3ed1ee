# SPDX-License-Identifier: BSD-3-Clause
"""What a registration result is made of."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform


class Status(StrEnum):
    """Why a registration was accepted or not."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"  # another pose explains the data nearly as well
    DEGENERATE = "degenerate"  # the data leave a direction free
    NO_OVERLAP = "no_overlap"  # the surveys do not cover a common region
    UNINFORMATIVE = "uninformative"  # the field has too little structure to tell places apart
    INCONSISTENT = "inconsistent"  # the best pose found does not explain the field


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another pose that explains the data, with its probability and log odds in nats (None where not computed).

    ``base`` says in which map, where the base was a folder and it is another than the result's.
    """

    T_base_target: RigidTransform
    probability: float | None = None
    base: str | None = None
    log_odds: float | None = None


@dataclass(frozen=True, slots=True)
class DegenerateDirection:
    """A direction of the tangent space that the data do not fix: unit 6-vector in target axes, and words."""

    xi: np.ndarray
    words: str


@dataclass(frozen=True, eq=False, slots=True)
class Links:
    """Corresponding points that support the answer, for pictures: row i of one belongs to row i of the other."""

    base: np.ndarray  # (k, 3), m, base frame
    target: np.ndarray  # (k, 3), m, target frame
