# SPDX-License-Identifier: BSD-3-Clause
"""What maps do not know moves the pose as far as the covariance says."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import Polynomial, box, prepared_map, some_field
from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.refine.refinement import RefinementConfig, refine, step_between
from magmatch.registration.refine.sensors import SensorConfig
from magmatch.registration.weigh.covariance import map_covariance

CONFIG = RefinementConfig(sensor=SensorConfig(mode="none"))
FIELD = some_field(3, slope=10e-6)


@dataclass(frozen=True)
class Map:
    """A field map as far as it is asked here: its posterior, whose weights are what a draw differs by."""

    mean: Polynomial

    @property
    def posterior(self):
        return self

    def evaluate(self, points, order=0, weights=None):
        values = self.mean.evaluate(points, order)
        if weights is None:
            return values
        error = weights.evaluate(points, order)
        gradient = None if values.gradient is None else values.gradient + error.gradient
        return replace(values, field=values.field + error.field, gradient=gradient)


@dataclass(frozen=True)
class Drawn:
    """One of the fields that a map thinks possible."""

    of: Map
    error: Polynomial

    def evaluate(self, points, order=0):
        return self.of.evaluate(points, order, self.error)


def error_fields(rng, size, n):
    return [
        Polynomial(size * rng.standard_normal(3), some_field(k, slope=size).linear) for k in rng.integers(0, 999, n)
    ]


@pytest.mark.parametrize("sizes", [(2e-8, 0.0), (0.0, 2e-8), (1e-8, 2e-8)])
def test_poses_in_drawn_maps_scatter_as_the_covariance_says(sizes):
    """Draws so small that one linear step is all; the tail bends less than it weighs by a tenth."""
    rng, n = np.random.default_rng(1), 6
    errors = [error_fields(rng, size, n) for size in sizes]
    base, target = (
        replace(prepared_map(FIELD, box(rng, 150), noise_sd=0.3e-6, sd=1e-6, spacing=0.05), field_map=Map(FIELD),
                draws=lambda drawn=drawn: drawn)
        for drawn in errors
    )  # fmt: skip

    def refined(*maps):
        start = RigidTransform.identity()
        return refine(*maps, start, PosePrior(10.0), CONFIG, np.random.default_rng(0), -1)

    best = refined(base, target)
    stated = map_covariance(base, target, best, CONFIG, seed=0)
    expected = np.zeros((6, 6))
    for k in range(n):
        for maps in (
            (replace(base, posterior=Drawn(base.field_map, errors[0][k])), target),
            (base, replace(target, posterior=Drawn(target.field_map, errors[1][k]))),
        ):
            step = step_between(best, refined(*maps))
            expected += np.outer(step, step) / n
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(stated / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.1)
