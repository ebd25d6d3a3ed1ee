# SPDX-License-Identifier: BSD-3-Clause
"""The default prior: a potential of cubic splines on cells near the data, smooth, with a soft law div B = 0."""

from typing import Any

from magmatch.field.box import Box
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.linear_model import LinearModel
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.tiles.region_model import lay_splines
from magmatch.field.tiles.tiled_model import TiledModel
from magmatch.typing import Points, Vectors


class SplinePrior:
    """Curl-free exactly (but where tiles blend), divergence-free softly, sparse: the cost follows the volume."""

    name = "spline"

    def choose_hyperparameters(
        self,
        points: Points,
        field: Vectors,
        box: Box | None = None,  # noqa: ARG002
        calibrate: bool = True,  # noqa: ARG002
    ) -> Hyperparameters:
        """Numbers under which the survey is most likely; deterministic."""
        return choose_spline_hyperparameters(points, field)

    def calibrated(
        self,
        points: Points,  # noqa: ARG002
        field: Vectors,  # noqa: ARG002
        hyperparameters: Hyperparameters,
        box: Box | None = None,  # noqa: ARG002
        model: LinearModel[Any] | None = None,  # noqa: ARG002
    ) -> Hyperparameters:
        """As they are: the choice holds their calibration."""
        return hyperparameters

    def is_affordable(self, points: Points, field: Vectors) -> bool:  # noqa: ARG002
        """Any survey is."""
        return True

    def build(
        self,
        points: Points,
        field: Vectors,  # noqa: ARG002
        hyperparameters: Hyperparameters,
        box: Box | None = None,  # noqa: ARG002
    ) -> SplineModel | TiledModel:
        """Lay splines over the surroundings of the points, in tiles where one factor would grow too large."""
        return lay_splines(points, hyperparameters)
