"""What maps do not know moves the pose as far as the covariance says."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import magmatch as mm
from magmatch.field.linear_model import Posterior
from magmatch.field.values import FieldValues
from magmatch.registration.config import PRESETS
from magmatch.registration.prepared.pose_prior import pose_prior
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.refine.refinement import refine
from magmatch.registration.weigh.map_covariance import map_covariance

N_DRAWS = 24

pytest.importorskip("magpylib", reason="needs the extra 'simulation'")


@dataclass(frozen=True)
class Drawn:
    """One of the fields that a map thinks possible."""

    posterior: Posterior
    weights: object

    def evaluate(self, points: np.ndarray, order: int = 0) -> FieldValues:
        return self.posterior.evaluate(points, order, self.weights)


def test_poses_in_drawn_maps_scatter_as_the_covariance_says():
    pair = mm.simulate("office-random", 4)
    config, rng = PRESETS["default"], np.random.default_rng(0)
    settings = config.refinement.model_copy(update={"n_steps": 6})
    base, target = (prepare(mm.build_map(survey), N_DRAWS, rng) for survey in (pair.base, pair.target))
    truth = base.T_map_model.inv() * pair.T_base_target * target.T_map_model
    prior = pose_prior(config.prior, base.T_map_model, target.T_map_model, base.raster.volume)

    def refined(base, target, start):
        return refine(base, target, start, prior, settings, np.random.default_rng(3))

    best = refined(base, target, truth)
    stated = map_covariance(base, target, best, settings, seed=3)
    draws = [m.field_map.posterior.draw_weights(N_DRAWS, rng) for m in (base, target)]
    moves = []
    for weights in zip(*draws, strict=True):
        maps = [
            replace(m, posterior=Drawn(m.field_map.posterior, w))
            for m, w in zip((base, target), weights, strict=True)
        ]
        away = best.T_base_target.inv() * refined(*maps, best.T_base_target).T_base_target
        moves.append(np.concatenate([away.rotation.as_rotvec(), away.apply(best.center) - best.center]))
    scatter = np.sqrt(np.mean(np.square(moves), axis=0))
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), scatter, rtol=0.7)
    assert 0.6 < np.sqrt(np.trace(stated[3:, 3:])) / np.linalg.norm(scatter[3:]) < 1.6
