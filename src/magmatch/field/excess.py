# SPDX-License-Identifier: BSD-3-Clause
"""Whether a fitted field is one that its samples make possible: the last look before a map is handed on."""

import logging
from typing import Protocol

import numpy as np

from magmatch.data.survey import Survey
from magmatch.data.units import field_text
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.values import FieldFunction
from magmatch.geometry import OCTAHEDRON
from magmatch.typing import Mask, Points

log = logging.getLogger(__name__)

# A field of three independent numbers, the fewest there are, varies five times less than its prior at the samples of
# one survey in a hundred: what varies so much more beside them is no chance, but a basis that is free there.
WIDEST = 5.0
# Below the rounding of any recording nothing is wide, T.
_LEAST_SPREAD = 1e-9
# Samples beside which the field is asked for, and how far beside, in the distance over which it changes.
_N_ASKED, _BESIDE = 200, 0.5


class FittedField(FieldFunction, Protocol):
    """A map, or a posterior."""

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Numbers that shape the prior."""

    def knows(self, points: Points) -> Mask:
        """Tell where the field counts as known."""


def excess(fitted: FittedField, samples: Survey) -> str:
    """In words, that the field beside samples, as far as it counts as known, is none they make possible; or empty."""
    some = samples.positions[:: -(-len(samples) // _N_ASKED)]
    beside = (some[:, None] + _BESIDE * fitted.hyperparameters.lengthscale * OCTAHEDRON).reshape(-1, 3)
    beside = beside[fitted.knows(beside)]
    mean = samples.field.mean(axis=0)
    spread = max(float(np.sqrt(((samples.field - mean) ** 2).mean())), _LEAST_SPREAD)
    found = float(np.sqrt(((fitted.evaluate(beside).field - mean) ** 2).mean())) if len(beside) else 0.0
    if found <= WIDEST * spread:
        return ""
    return f"varies by {field_text(found)} beside samples that vary by {field_text(spread)}"


def warn_of_excess(fitted: FittedField, samples: Survey) -> None:
    """Warn if the field of a map is none that its samples make possible."""
    if words := excess(fitted, samples):
        log.warning("%s: the map's field %s, which they do not show: use another prior", samples.name, words)
