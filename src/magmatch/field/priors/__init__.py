# SPDX-License-Identifier: BSD-3-Clause
"""Families of field models; a table of them is what configuration names refer to.

The default is a potential of cubic splines on cells near the data, smooth, with a soft law div B = 0.
"""

from magmatch.field.domain import Box
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import CURL_FREE, DIVERGENCE_FREE, GRADIENT
from magmatch.field.linear_model import Prior, check_samples
from magmatch.field.priors.harmonic import HarmonicPrior
from magmatch.field.selection.spline_hyperparameters import choose_spline_hyperparameters
from magmatch.field.tiles.region_model import TiledModel, WholeModel, lay_splines
from magmatch.typing import Points, Vectors

# Three weights each: more take minutes.
MAX_INDUCING_POINTS = 1200


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


# Their cost grows with the cube of their weights: not every survey can afford them. The first is published; the
# second, minus the gradient of a potential (Solin et al. 2018), has one weight an inducing point.
DENSE_PRIORS: dict[str, InducingPrior | HarmonicPrior] = {
    "divergence_free": InducingPrior("divergence_free", DIVERGENCE_FREE, DIVERGENCE_FREE, MAX_INDUCING_POINTS),
    "curl_free": InducingPrior("curl_free", CURL_FREE, GRADIENT, 3 * MAX_INDUCING_POINTS),
    "harmonic": HarmonicPrior(),
}
PRIORS: dict[str, Prior] = {"spline": SplinePrior(), **DENSE_PRIORS}


def prior_over(name: str, box: Box | None) -> Prior:
    """Prior of a name; one that rules sources out rules them out of a declared box, too."""
    return HarmonicPrior(box=box) if name == HarmonicPrior.name and box is not None else PRIORS[name]
