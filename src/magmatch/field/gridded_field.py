# SPDX-License-Identifier: BSD-3-Clause
"""A map evaluated on a regular grid."""

from dataclasses import dataclass

from magmatch.field.values import FieldValues
from magmatch.grid import RegularGrid
from magmatch.typing import Mask, Scalars


@dataclass(frozen=True, eq=False, slots=True)
class GriddedField:
    """A map evaluated on a regular grid; arrays are in the grid's C order, components in the map frame.

    Attributes
    ----------
    values : FieldValues
        Field and derivatives at ``grid.points()``.
    variance : (n,) array, T^2
        Mean posterior variance of the three components, returning to the prior away from data; NaN where it
        was not asked for.
    is_known : (n,) bool array
        Where the map has data nearby.
    """

    grid: RegularGrid
    values: FieldValues
    variance: Scalars
    is_known: Mask
