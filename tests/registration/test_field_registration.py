"""Claims about the default registration, on maps whose field is known exactly."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from magmatch.estimation.pose_prior import PosePrior
from magmatch.field.values import FieldValues
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.refine.refinement import RefinedPose, RefinementConfig, look_up, refine, residual_jacobian
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.evidence import weigh_pose


@dataclass(frozen=True)
class BiasedPosterior:
    """What a map says when its sensor was biased: everything scaled or bent, a constant added."""

    honest: object
    gain: np.ndarray
    bias: np.ndarray

    def evaluate(self, points, order=0, weights=None):
        v = self.honest.evaluate(points, order, weights)
        gradient = None if v.gradient is None else self.gain @ v.gradient
        return FieldValues(v.field @ self.gain.T + self.bias, gradient)

    def __getattr__(self, name):
        return getattr(self.honest, name)


# Any pose within a room.
FLAT = PosePrior(10.0)


@pytest.fixture(scope="module")
def prepared_pair(make_exact_pair):
    T_base_target = random_transform(np.random.default_rng(3))
    base_map, target_map = make_exact_pair(5, T_base_target)
    rng = np.random.default_rng(0)
    base, target = prepare(base_map, 4, rng), prepare(target_map, 4, rng)
    T_model = base.T_map_model.inv() * T_base_target * target.T_map_model
    return base, target, T_model


def error(T, T_true, target):
    return transform_error(T, T_true, target.samples.mean(axis=0))


@pytest.mark.parametrize("level", [0, 1, 2])
def test_swapping_base_and_target_inverts_the_pose(prepared_pair, level):
    base, target, T_true = prepared_pair
    one, other = (
        refine(*pair, start, FLAT, RefinementConfig(), np.random.default_rng(0), level).T_base_target
        for pair, start in (((base, target), T_true), ((target, base), T_true.inv()))
    )
    distance, angle = error(other.inv(), one, target)
    found, _ = error(one, T_true, target)
    assert distance < 0.1 * found
    assert angle < 1e-5


def test_jacobian_is_the_derivative_of_the_residual(prepared_pair):
    base, target, T_true = prepared_pair
    sensor = identical_sensors(SensorConfig(mode="scale"), 1)
    pose = RefinedPose(T_true, target.samples.mean(axis=0), sensor, np.ones(4), np.zeros((6, 6)), ())
    rows = np.arange(0, 800, 8), np.arange(0, 800, 8)

    def residuals(xi):
        return [side.residual for side in look_up(base, target, pose.stepped(xi), rows)]

    steps = np.diag([1e-5] * 6 + [1e-9] * 3 + [1e-6])
    for k, side in enumerate(look_up(base, target, pose, rows)):
        numeric = np.stack([(residuals(e)[k] - residuals(-e)[k]) / (2 * e.max()) for e in steps], axis=2)
        J = residual_jacobian(side, pose)
        assert np.all(np.abs(numeric - J).max(axis=(0, 1)) < 1e-5 * np.abs(J).max(axis=(0, 1)))


IRON = np.array([[1.03, 0.02, -0.01], [0.015, 0.98, 0.02], [-0.02, 0.01, 1.0]])


@pytest.mark.parametrize(
    ("gain", "level", "atol", "degrees"),
    [(1.03 * np.eye(3), 1, 0.003, 0.1), (IRON, 2, 0.01, 0.3)],
    ids=["scale", "iron"],
)
def test_a_sensors_bias_scale_and_soft_iron_are_noticed_and_taken_off(make_exact_pair, gain, level, atol, degrees):
    """A model that allows for less explains less: none that a bias and a scale, these that soft iron."""
    T_true = random_transform(np.random.default_rng(8))
    base_map, target_map = make_exact_pair(8, T_true)
    bias, R = np.array([2e-6, -1e-6, 1.5e-6]), target_map.T_map_model.rotation.as_matrix()
    survey = replace(target_map.survey, field=target_map.survey.field @ gain.T + bias)
    posterior = BiasedPosterior(target_map.posterior, R.T @ gain @ R, R.T @ bias)
    rng = np.random.default_rng(0)
    base, target = prepare(base_map, 4, rng), prepare(replace(target_map, survey=survey, posterior=posterior), 4, rng)
    T_model = base.T_map_model.inv() * T_true * target.T_map_model
    config, nulls = RefinementConfig(), null_models_of(base, target)
    less, pose = (
        refine(base, target, T_model, FLAT, config, np.random.default_rng(0), one) for one in (level - 1, level)
    )
    found = weigh_pose(base, target, pose, nulls, FLAT)
    assert found.log_evidence > weigh_pose(base, target, less, nulls, FLAT).log_evidence
    assert error(pose.T_base_target, T_model, target)[1] < np.radians(degrees)
    np.testing.assert_allclose(R @ pose.sensor.gain @ R.T, gain, atol=atol)
    if level == 1:
        np.testing.assert_allclose(R @ pose.sensor.bias, bias, atol=0.2e-6)


def test_like_sensors_are_left_alike(prepared_pair):
    base, target, T_true = prepared_pair
    config, nulls = RefinementConfig(), null_models_of(base, target)
    like, free = (
        weigh_pose(
            base, target, refine(base, target, T_true, FLAT, config, np.random.default_rng(0), level), nulls, FLAT
        )
        for level in (0, 1)
    )
    assert free.log_evidence < like.log_evidence
