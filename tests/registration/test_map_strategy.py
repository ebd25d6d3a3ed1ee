# SPDX-License-Identifier: BSD-3-Clause
"""What settling a probable pose adds to its covariance, and what it leaves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import Drawn, box, prepared_map, some_field
from magmatch.estimation.pose_prior import FAR2
from magmatch.geometry import random_transform
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.refine.refinement import RefinementConfig, refine
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.covariance import drift_covariance, enclosing, map_covariance
from magmatch.registration.weigh.evidence import Change, weigh_pose

RNG = np.random.default_rng(0)
FIELD = some_field(3, slope=10e-6)
CONFIG = RegistrationConfig(refinement=RefinementConfig(sensor=SensorConfig(mode="none")))
T_BASE, T_TARGET = random_transform(RNG), random_transform(RNG)


def settled(spread=0.0, **changes):
    """Pair, strategy and a pose of two maps whose draws differ by constants; the target's own positions drift."""
    rng = np.random.default_rng(1)
    draws = [spread * rng.standard_normal(3) for _ in range(6)]
    known = {"field_map": Drawn(FIELD), "draws": lambda: draws}
    base = replace(prepared_map(FIELD, box(rng, 300, (2.6, 2.2, 1.4)), rng, length=0.5), T_map_model=T_BASE, **known)
    target = replace(prepared_map(FIELD, box(rng, 300), rng, length=0.8), T_map_model=T_TARGET, **known)
    strategy = MapStrategy(target, CONFIG, 0)
    pair = strategy.pair(MapIndex(base))
    here = RigidTransform.identity()
    pose = refine(base, target, here, pair.prior, "none", np.random.default_rng(0), -1)
    blocks = tuple(replace(b, drift=1e-3 * b.information**2 / np.abs(b.information).max()) for b in pose.blocks)
    best = weigh_pose(base, target, replace(pose, blocks=blocks), null_models_of(base, target), pair.prior)
    return pair, strategy, replace(best, **changes)


def in_survey_axes(C):
    R = np.kron(np.eye(2), T_TARGET.rotation.as_matrix())
    return R @ C @ R.T


def test_a_pose_is_stated_as_its_cells_show_it_in_the_surveys_frames():
    pair, strategy, best = settled()
    assert pair.length == 0.5  # the shorter one
    stated, support = strategy.state(pair, best)
    expected = T_BASE * best.T_base_target * T_TARGET.inv()
    np.testing.assert_allclose(stated.T_base_target.as_matrix(), expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(stated.covariance, in_survey_axes(best.covariance), rtol=1e-9)
    assert (support.n_inliers, support.residual, support.sensor) == (best.n_good, best.residual, None)


def test_links_join_the_samples_that_the_base_explains_and_sensors_differ_in_the_targets_survey_axes():
    pair, strategy, best = settled()
    D = np.array([[0.02, 0.01, 0.0], [0.0, -0.01, 0.03], [0.01, 0.0, 0.005]])
    sensor = identical_sensors("full", 1).stepped(np.array([1e-6, 2e-6, -1e-6, *D.ravel()]))
    half = np.arange(300) % 2 == 0
    block = replace(best.pose.blocks[0], positions=pair.target.samples, residual2=FAR2 * np.where(half, 0.99, 1.01))
    pose = replace(best.pose, sensor=sensor, sensor_sd=np.full(12, 1e-6), blocks=(block,))
    stated, support = strategy.state(pair, replace(best, pose=pose))
    np.testing.assert_allclose(support.links.target, T_TARGET.apply(pair.target.samples[half]), atol=1e-12)
    np.testing.assert_allclose(support.links.base, stated.T_base_target.apply(support.links.target), atol=1e-12)
    R = T_TARGET.rotation.as_matrix()
    np.testing.assert_allclose(support.sensor["bias"], R @ [1e-6, 2e-6, -1e-6], atol=1e-15)
    np.testing.assert_allclose(support.sensor["gain"], R @ (np.eye(3) + D) @ R.T, atol=1e-12)
    assert support.sensor["scale"] == pytest.approx(1 + np.trace(D) / 3)
    assert support.sensor["prior_sd"] == [1e-6] * 12
    _, without = strategy.state(pair, replace(best, pose=replace(pose, blocks=())))
    assert len(without.links.target) == 0


@pytest.mark.parametrize("spread", [0.0, 1e-6])
def test_a_settled_pose_is_as_wide_as_cells_or_maps_show_and_drifts_with_the_surveys(spread):
    pair, strategy, best = settled(spread)
    of_maps = map_covariance(pair.base, pair.target, best.pose, 0)
    drift = drift_covariance(best.pose)
    final, _ = strategy.settle(pair, best)
    expected = in_survey_axes(enclosing(best.covariance, of_maps) + drift)
    np.testing.assert_allclose(final.covariance, expected, rtol=1e-6, atol=1e-15)
    assert np.linalg.eigvalsh(drift).max() > 0
    # Never narrower than it was weighed.
    scale = np.sqrt(np.diag(final.covariance))
    wider = (final.covariance - strategy.state(pair, best)[0].covariance) / np.outer(scale, scale)
    assert np.linalg.eigvalsh(wider).min() > -1e-9
    is_of_maps = np.trace(of_maps) > 2 * np.trace(best.covariance)
    assert is_of_maps == (spread > 0)


def test_beside_a_change_the_maps_are_not_counted_once_more():
    pair, strategy, best = settled(1e-6, change=Change(np.zeros((300, 3)), np.arange(9), 0.7, 0.0))
    final, _ = strategy.settle(pair, best)
    expected = in_survey_axes(best.covariance + drift_covariance(best.pose))
    np.testing.assert_allclose(final.covariance, expected, rtol=1e-6, atol=1e-15)
