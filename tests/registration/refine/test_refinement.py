# SPDX-License-Identifier: BSD-3-Clause
"""The dense refinement: its likelihood, its steps, and what it does where the field or the prior says nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import Polynomial, box, prepared_map, some_field, turn_about
from magmatch.estimation.pose_prior import PosePrior
from magmatch.geometry import rotation_matrix, transform_error
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.refine import refinement
from magmatch.registration.refine.refinement import (
    RefinedPose,
    ResidualBlock,
    compare,
    look_up,
    overdispersion,
    refine,
    residual_jacobian,
    residual_weights,
    step_between,
)
from magmatch.registration.refine.sensors import identical_sensors
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.evidence import weigh_pose

FLAT = PosePrior(10.0)
FIELD = some_field(3, slope=10e-6, bend=6e-6)
# Of the log-likelihood ``-(nu + 3) / 2 ln(1 + r^2 / nu V)``.
DOF = 4.0


def pair_of(seed=0, n=150, drifts=(0.0, 0.0)):
    """Two surveys of one place in one frame, each inside the other's map; positions stated to be off by so much."""
    rng = np.random.default_rng(seed)
    maps = []
    for drift in drifts:
        none = Drift(drift, 0.0, np.zeros(n, dtype=np.int64), np.zeros((1, 1)))
        maps.append(prepared_map(FIELD, box(rng, n), rng, drift=none, spacing=0.05))
    return maps


def refined(base, target, start, prior=FLAT, sensors="none", level=-1):
    return refine(base, target, start, prior, sensors, np.random.default_rng(0), level)


def both(base, target, T, noise=None):
    rows = np.arange(len(target.samples)), np.arange(len(base.samples))
    pose = RefinedPose(
        T, target.samples.mean(axis=0), identical_sensors("none", -1), np.ones(3), np.zeros((6, 6)), ()
    )
    return look_up(base, target, pose, rows), compare(base, target, pose, rows), pose


def test_residuals_of_both_sides_are_in_the_targets_axes():
    base, target = pair_of()
    T = turn_about(np.zeros(3), np.array([0.1, -0.2, 0.1, 0.05, -0.03, 0.04]))
    (forward, backward), *_ = both(base, target, T)
    R = rotation_matrix(T)
    y, x = forward.positions, base.samples[backward.rows]
    np.testing.assert_array_equal(y, target.samples[forward.rows])
    np.testing.assert_allclose(T.apply(backward.positions), x, atol=1e-12)
    expected = target.sample_field[forward.rows] - FIELD.evaluate(T.apply(y)).field @ R
    np.testing.assert_allclose(forward.residual, expected, atol=1e-17)
    expected = FIELD.evaluate(T.inv().apply(x)).field - base.sample_field[backward.rows] @ R
    np.testing.assert_allclose(backward.residual, expected, atol=1e-17)


def test_a_block_holds_the_gradient_and_the_curvature_of_the_student_likelihood():
    """Scores and curvature against finite differences in the shift; large residuals bend it less than they weigh."""
    base, target = pair_of(n=60)
    field = target.sample_field.copy()
    field[:8] += 8e-6
    target = replace(target, sample_field=field)
    (forward, _), (block, _), pose = both(base, target, RigidTransform.identity())
    r2 = (forward.residual**2).sum(axis=1)
    weight, _ = residual_weights(r2, forward.sd, target.noise_sd)
    # One variance for all, which the weights reveal.
    V = ((DOF + 3) / weight - r2) / DOF
    assert np.ptp(V) < 1e-9 * V[0]
    J = residual_jacobian(forward, pose)

    def loss(shift):
        r = forward.residual + J[:, :, 3:6] @ shift
        return 0.5 * (DOF + 3) * np.log1p((r**2).sum(axis=1) / (DOF * V[0]))

    step = 1e-6
    slopes = np.stack([(loss(step * e) - loss(-step * e)) / (2 * step) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(block.scores[:, 3:6], slopes, atol=1e-5 * np.abs(slopes).max())
    np.testing.assert_allclose(block.residual2, r2 / (target.noise_sd**2 + forward.sd**2), rtol=1e-12)
    JW = J * weight[:, None, None]
    np.testing.assert_allclose(block.information, np.einsum("nip,niq->pq", JW, J), rtol=1e-9)


def test_the_curvature_is_that_of_the_likelihood_averaged_over_directions():
    residual2, noise_sd = np.random.default_rng(3).chisquare(3, 200) * 0.5, 1.0
    weight, bend = residual_weights(residual2, np.zeros(200), noise_sd)
    # No less than the noise's variance: 1.
    np.testing.assert_allclose(weight, 7 / (4 + residual2), rtol=1e-12)
    h = 1e-4

    def loss(r):
        return 3.5 * np.log1p((r**2).sum(axis=-1) / 4)

    r = np.zeros((200, 3))
    r[:, 0] = np.sqrt(residual2)
    bends = sum(loss(r + h * e) + loss(r - h * e) - 2 * loss(r) for e in np.eye(3)) / (3 * h**2)
    np.testing.assert_allclose(weight * bend, bends, rtol=1e-5)


def test_in_a_uniform_field_refinement_ends_at_the_priors_pose():
    """The field fixes two turns; along all else the prior has the only word."""
    rng = np.random.default_rng(1)
    base, target = (prepared_map(Polynomial(), box(rng, 60), noise_sd=0.3e-6) for _ in range(2))
    center = target.samples.mean(axis=0)
    start = turn_about(center, np.array([0.0, 0.0, 0.0, 0.06, -0.04, 0.05]))
    prior = PosePrior(10.0, RigidTransform.identity(), np.diag(np.repeat([0.05, 0.1], 3) ** 2))
    found = refined(base, target, start, prior)
    np.testing.assert_allclose(
        step_between(found, replace(found, T_base_target=RigidTransform.identity())), 0, atol=1e-6
    )
    up = np.array([0.0, 0.6, 0.8])
    leaning = turn_about(center, np.append(0.05 * np.cross(up, [0.0, 0.0, 1.0]), np.zeros(3)))
    upright = refined(base, target, leaning, PosePrior(10.0, None, None, up, up, 0.01))
    np.testing.assert_allclose(upright.T_base_target.rotation.apply(up), up, atol=1e-6)


def test_a_pose_between_field_and_prior_weighs_both_by_their_information():
    base, target = pair_of(2)
    free = refined(base, target, RigidTransform.identity())
    sd = np.repeat([2e-4, 2e-4], 3)
    away = turn_about(free.center, np.array([2e-4, -3e-4, 2e-4, 4e-4, -3e-4, 2e-4]))
    prior = PosePrior(10.0, free.T_base_target * away, np.diag(sd**2))
    found = refined(base, target, free.T_base_target, prior)
    pull = step_between(free, replace(free, T_base_target=free.T_base_target * away))
    A = sum(b.curvature for b in free.blocks)[:6, :6] / overdispersion(free.blocks, 1.2)
    expected = np.linalg.solve(A + np.diag(sd**-2.0), pull / sd**2)
    np.testing.assert_allclose(step_between(free, found), expected, atol=0.05 * np.abs(expected).max())
    np.testing.assert_allclose(np.diag(found.prior_information), sd**-2.0, rtol=1e-2)
    assert found.known_before.shape == (9, 9)
    np.testing.assert_allclose(np.diag(found.known_before)[6:], found.sensor_sd**-2.0)


def test_refinement_goes_home_from_nearby_and_stays_where_maps_do_not_overlap():
    base, target = pair_of(4)
    home = refined(base, target, RigidTransform.identity())
    start = turn_about(home.center, np.array([0.05, -0.08, 0.06, 0.1, -0.08, 0.05]))
    again = refined(base, target, start)
    assert np.abs(step_between(home, again)).max() < 1e-5
    away = RigidTransform.from_translation([9.0, 0, 0])
    nowhere = refined(base, target, away)
    assert nowhere.blocks == ()
    np.testing.assert_array_equal(nowhere.T_base_target.as_matrix(), away.as_matrix())


def test_no_step_is_longer_than_allowed(monkeypatch):
    monkeypatch.setattr(refinement, "MOST_STEPS", 1)
    base, target = pair_of(4)
    start = turn_about(np.zeros(3), np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0]))
    found = refined(base, target, start)
    step = step_between(replace(found, T_base_target=start), found)
    assert max(np.abs(step[:3]).max() / 0.1, np.abs(step[3:]).max() / (0.3 * 0.6)) == pytest.approx(1.0)


def test_sums_over_cells_scatter_as_samples_do_where_those_are_independent_and_more_where_they_are_not():
    rng, n = np.random.default_rng(5), 20_000
    J = rng.normal(size=(n, 6))
    x = rng.uniform(0, 1, (n, 3))
    cell = np.unique(np.floor(x / 0.2), axis=0, return_inverse=True)[1].ravel()

    def excess(noise):
        scores = J * noise[:, None]
        return overdispersion((ResidualBlock(J.T @ J, J.T @ J, scores, x, noise**2, np.zeros((6, 6))),) * 2, 0.2)

    assert excess(2 * rng.normal(size=n)) == pytest.approx(4, rel=0.15)
    assert excess(0.1 * rng.normal(size=n)) == 1.0
    J[:] = 1 + 0.1 * J
    # One direction of six, of as many samples as a cell holds.
    assert excess(rng.normal(size=125)[cell]) == pytest.approx(n / 125 / 6, rel=0.3)


@pytest.mark.parametrize("sensors", ["bias", "scale", "full"])
def test_the_jacobian_is_the_derivative_of_the_residual(sensors):
    base, target = pair_of(n=60)
    sensor, T = identical_sensors(sensors, 1), turn_about(np.zeros(3), np.full(6, 0.05))
    n = sensor.n_parameters
    pose = RefinedPose(T, target.samples.mean(axis=0), sensor, np.ones(n), np.zeros((6, 6)), ())
    rows = np.arange(60), np.arange(60)

    def residuals(xi):
        return [side.residual for side in look_up(base, target, pose.stepped(xi), rows)]

    steps = np.diag([1e-5] * 6 + [1e-9] * 3 + [1e-6] * (n - 3))
    for k, side in enumerate(look_up(base, target, pose, rows)):
        numeric = np.stack([(residuals(e)[k] - residuals(-e)[k]) / (2 * e.max()) for e in steps], axis=2)
        J = residual_jacobian(side, pose)
        assert np.all(np.abs(numeric - J).max(axis=(0, 1)) < 1e-5 * np.abs(J).max(axis=(0, 1)))


IRON = np.array([[1.06, 0.04, -0.02], [0.03, 0.96, 0.04], [-0.04, 0.02, 1.0]])
BIAS = np.array([2e-6, -1e-6, 1.5e-6])


def read_by_another_sensor(gain, bias):
    """Two maps of a steep field, the target's read by a sensor of some gain and bias."""
    field, rng = some_field(3, slope=40e-6, bend=80e-6), np.random.default_rng(0)
    read = Polynomial(gain @ field.constant + bias, gain @ field.linear, np.einsum("ab,bcd->acd", gain, field.second))
    return tuple(prepared_map(one, box(rng, 400), rng, spacing=0.05) for one in (field, read))


def at_level(base, target, level):
    """The pose with sensors that differ so freely, and its evidence."""
    pose = refined(base, target, RigidTransform.identity(), sensors="auto", level=level)
    return pose, weigh_pose(base, target, pose, null_models_of(base, target), FLAT).log_evidence


@pytest.mark.parametrize(
    ("gain", "level", "atol"), [(1.03 * np.eye(3), 1, 0.003), (IRON, 2, 0.01)], ids=["scale", "iron"]
)
def test_a_sensors_bias_scale_and_soft_iron_are_noticed_and_taken_off(gain, level, atol):
    """A model that allows for less explains less: none that a bias and a scale, these that soft iron."""
    maps = read_by_another_sensor(gain, BIAS)
    (_, less), (pose, evidence) = (at_level(*maps, one) for one in (level - 1, level))
    assert evidence > less
    assert pose.T_base_target.rotation.magnitude() < 2e-3
    np.testing.assert_allclose(pose.sensor.gain, gain, atol=atol)
    np.testing.assert_allclose(pose.sensor.bias, BIAS, atol=0.2e-6)


def test_like_sensors_are_left_alike_and_swapping_base_and_target_inverts_the_pose():
    base, target = read_by_another_sensor(np.eye(3), np.zeros(3))
    found = [at_level(base, target, level) for level in (0, 1, 2)]
    assert found[0][1] > found[1][1] > found[2][1]
    center = target.samples.mean(axis=0)
    for level, (pose, _) in enumerate(found):
        swapped, _ = at_level(target, base, level)
        off, _ = transform_error(pose.T_base_target, RigidTransform.identity(), center)
        distance, angle = transform_error(swapped.T_base_target.inv(), pose.T_base_target, center)
        assert distance < 0.1 * off < 1e-3
        assert angle < 1e-5
