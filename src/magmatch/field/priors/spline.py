# SPDX-License-Identifier: BSD-3-Clause
"""The default prior: a potential of cubic splines on cells near the data, smooth, with a soft law div B = 0."""

from magmatch.field.cross_validation import choose_spline_hyperparameters
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline_model import SplineModel
from magmatch.typing import Points, Vectors


class SplinePrior:
    """Curl-free exactly, divergence-free softly, sparse: the cost follows the surveyed volume."""

    name = "spline"

    def choose_hyperparameters(self, points: Points, field: Vectors) -> Hyperparameters:
        """Numbers that predict left-out parts of the survey best; deterministic."""
        return choose_spline_hyperparameters(points, field)

    def build(self, points: Points, field: Vectors, hyperparameters: Hyperparameters) -> SplineModel:  # noqa: ARG002
        """Lay splines over the surroundings of the points."""
        return SplineModel.over(points, hyperparameters)
