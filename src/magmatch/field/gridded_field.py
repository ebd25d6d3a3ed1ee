# SPDX-License-Identifier: BSD-3-Clause
"""A map evaluated on a regular grid."""

from dataclasses import dataclass

from magmatch.field.values import FieldValues
from magmatch.grid import RegularGrid
from magmatch.typing import Mask, Scalars


@dataclass(frozen=True, eq=False, slots=True)
class GriddedField:
    """A map evaluated on a regular grid; arrays are in the grid's C order, components in the map frame."""

    grid: RegularGrid
    values: FieldValues  # field and derivatives at ``grid.points()``
    # (n,), T^2: mean posterior variance of the three components, returning to the prior away from data; NaN where it
    # was not asked for
    variance: Scalars
    is_known: Mask  # (n,): where the map has data nearby
