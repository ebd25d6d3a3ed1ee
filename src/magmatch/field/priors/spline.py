# SPDX-License-Identifier: BSD-3-Clause
"""The default prior: a potential of cubic splines on cells near the data, smooth, with a soft law div B = 0."""

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import check_samples
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.tiles.region_model import TiledModel, WholeModel, lay_splines
from magmatch.typing import Points, Vectors


class SplinePrior:
    """Curl-free exactly (but where tiles blend), divergence-free softly, sparse: the cost follows the volume."""

    name = "spline"
    is_calibrated = True

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Numbers under which the survey is most likely; deterministic."""
        return choose_spline_hyperparameters(points, field)

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> WholeModel | TiledModel:
        """Lay splines over the surroundings of the points, in tiles where one factor would grow too large."""
        check_samples(points, field, 1)
        return lay_splines(points, hyperparameters)
