# SPDX-License-Identifier: BSD-3-Clause
"""Places that do not exist but could: what the best pose of a search must beat.

The mirror image of a static magnetic field, and the field of all sources reversed, obey Maxwell's laws as the field
itself does, and vary over the same distances by the same amounts. They are nowhere, so whatever a search finds
in them is chance: how well a wrong pose can explain this very target in a place just like this very base.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from magmatch.features.invariants import mirrored_invariants
from magmatch.field.values import FieldFunction, FieldValues
from magmatch.registration.prepared.pose_prior import PosePrior
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.raster import Raster
from magmatch.typing import Points

# Mirrored in the plane x = 0 or not, and the sign of the field.
DECOYS = ((True, 1.0), (False, -1.0), (True, -1.0))
_MIRROR = np.array([-1.0, 1.0, 1.0])


def decoys(base: PreparedMap, prior: PosePrior) -> Iterator[tuple[PreparedMap, PosePrior]]:
    """Lawful fields of the same statistics as a map's, none of which is anywhere."""
    for is_mirrored, sign in DECOYS:
        axes = _MIRROR if is_mirrored else np.ones(3)
        decoy = replace(
            base,
            posterior=_Reflected(base.posterior, axes, sign),
            samples=base.samples * axes,
            sample_field=sign * base.sample_field * axes,
            points=base.points * axes,
            point_field=sign * base.point_field * axes,
            point_gradient=sign * base.point_gradient * np.outer(axes, axes),
            invariants=mirrored_invariants(base.invariants, is_mirrored=is_mirrored, sign=sign),
            raster=_reflected_raster(base.raster, is_mirrored, sign),
        )
        yield decoy, prior if prior.up_base is None else replace(prior, up_base=prior.up_base * axes)


@dataclass(frozen=True, eq=False, slots=True)
class _Reflected:
    """A posterior seen in a mirror, its field reversed where the sign is negative."""

    inner: FieldFunction
    axes: np.ndarray
    sign: float

    def evaluate(self, points: Points, order: int = 0) -> FieldValues:
        """Field and, for order 1, its gradient at mirrored points."""
        values = self.inner.evaluate(points * self.axes, order=order)
        gradient = None if values.gradient is None else self.sign * values.gradient * np.outer(self.axes, self.axes)
        return FieldValues(self.sign * values.field * self.axes, gradient)


def _reflected_raster(raster: Raster, is_mirrored: bool, sign: float) -> Raster:
    values = raster.values * np.append(np.full(3, sign), 1.0)
    if not is_mirrored:
        return replace(raster, values=values)
    origin = raster.origin.copy()
    origin[0] = -(raster.origin[0] + (raster.sd.shape[0] - 1) * raster.spacing)
    return replace(raster, origin=origin, values=np.ascontiguousarray(values[::-1] * np.append(_MIRROR, 1.0)))
