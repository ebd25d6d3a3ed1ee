# SPDX-License-Identifier: BSD-3-Clause
"""A region that one factor can hold: the spline model as the only tile of itself."""

from collections.abc import Mapping

import numpy as np

from magmatch.field.linear_model import Index, Runner, StoredTile
from magmatch.field.spline.spline_model import WHOLE, SplineModel, SplinePosterior
from magmatch.field.tiles.tile_fit import Samples, fit_weights
from magmatch.field.tiles.tile_tasks import TileTasks
from magmatch.typing import Points, Vectors


class WholeModel(SplineModel):
    """Splines over a region in one piece; fits and stores like `TiledModel`."""

    __slots__ = ()

    @property
    def n_operations(self) -> float:
        """Floating-point operations of a fit."""
        return self.elimination.n_operations

    def fit(
        self, points: Points, field: Vectors, stored: Mapping[Index, StoredTile], run: Runner, /
    ) -> SplinePosterior:
        """Fit samples, or recall the very fit of them that is stored."""
        if not stored:
            return self.infer_in_single_precision(self.observe(points, field))
        task = self.tasks_of(points, field).task(0)
        is_same = WHOLE in stored and stored[WHOLE].fingerprint == task.fingerprint()
        return task.recall(stored[WHOLE].weights if is_same else next(iter(run(fit_weights, [task]))))

    def tasks_of(self, points: Points, field: Vectors) -> TileTasks:
        """What the weights follow from."""
        samples, every = Samples(points, field, np.ones(len(points))), [np.arange(len(points))]
        return TileTasks(self.hyperparameters, None, [WHOLE], points, every, (samples,), [every])
