# SPDX-License-Identifier: BSD-3-Clause
"""Biases of logs' sensors, solved with the field of their map."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from dipoles import dipoles
from magmatch.cli.commands.info import info_table
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.field.fit import fit_unbounded
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.priors import PRIORS
from magmatch.field.sensor_biases import SensorBiases, biased_logs, no_biases, sensor_axes, solve_biases
from magmatch.field.tiles.region_model import TiledModel
from magmatch.field.tiles.tiles import Tiling
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap

NUMBERS = Hyperparameters(lengthscale=1.6, signal_sd=8e-6, noise_sd=3e-7, spacing=0.6, divergence_weight=300.0)
SPREAD = 8e-6
AS_IS = Rotation.identity()


def field_at(points):
    """Field of three dipoles below the floor, and Earth's, T."""
    places, moments = ((1, 1, -1.6), (3, 2, -1.8), (2, 3, -1.6)), np.array([(3, 1, 8), (-5, 3, 9), (1, 6, -7)])
    return np.array([20e-6, 0.0, -40e-6]) + dipoles(points, places, 8e-6 * moments)


def walk(rng, bias, n=60, noise=2e-7):
    """Most of a circle in a room of 4 m, its sensor turned along it."""
    angle = rng.uniform(0, 2 * np.pi) + np.linspace(0, 5, n)
    r = rng.uniform(0.7, 1.4)
    x, y = rng.uniform(r, 4 - r, (2, 1)) + r * np.array([np.cos(angle), np.sin(angle)])
    p = np.column_stack([x, y, np.zeros(n)])
    R = Rotation.from_euler("z", np.arctan2(np.gradient(y), np.gradient(x))[:, None])
    field = field_at(p) + R.apply(bias) + rng.normal(0, noise, (n, 3))
    return Survey(p, field, np.arange(n) * 0.1, R, name="walk")


def walks(n_walks, spread=SPREAD, seed=0, **kinds):
    rng = np.random.default_rng(seed)
    biases = rng.normal(0, spread, (n_walks, 3)) if spread else np.zeros((n_walks, 3))
    return [walk(rng, bias, **kinds) for bias in biases], biases


@pytest.fixture(scope="module")
def mapped():
    surveys, biases = walks(6, n=40)
    return build_map(surveys, SPLINE), surveys, biases


def unordered(survey):
    """Its samples in no order, without orientations."""
    rows = np.random.default_rng(3).permutation(len(survey))
    return replace(survey, positions=survey.positions[rows], field=survey.field[rows], times=None, orientations=None)


def solved(surveys, spread=SPREAD, prior="spline"):
    samples = surveys[0].merged(*surveys[1:])
    posterior = fit_unbounded(samples, NUMBERS, PRIORS[prior], {}, None)
    logs = biased_logs(surveys)
    return posterior, samples, solve_biases(posterior, AS_IS, samples, surveys, logs, spread, attitude_sd=0.0)


def columns_of(surveys):
    """Field at all samples per unit of each bias, (3 n, 3 l)."""
    G, start = np.zeros((3 * sum(map(len, surveys)), 3 * len(surveys))), 0
    for k, survey in enumerate(surveys):
        end = start + 3 * len(survey)
        G[start:end, 3 * k : 3 * k + 3] = survey.orientations.as_matrix().reshape(-1, 3)
        start = end
    return G


def expect_joint_solution(found, G, whitened, field):
    """``whitened``: the inverse covariance of field and noise, times G."""
    C = np.linalg.inv(G.T @ whitened + np.eye(G.shape[1]) / SPREAD**2)
    np.testing.assert_allclose(found.bias.ravel(), C @ whitened.T @ field.ravel(), atol=1e-9)
    np.testing.assert_allclose(found.sd.ravel(), np.sqrt(np.diag(C)), rtol=1e-4)


def test_biases_are_those_of_a_gaussian_process_with_bias_columns():
    surveys, _ = walks(3, n=25)
    posterior, samples, found = solved(surveys, prior="curl_free")
    K, s = posterior.influence(samples.positions), NUMBERS.noise_sd
    # The covariance of the field that a smoother S stands for: S = K (K + s^2)^-1.
    K = s**2 * np.linalg.solve(np.eye(len(K)) - K, K)
    G = columns_of(surveys)
    expect_joint_solution(found, G, np.linalg.solve(K + s**2 * np.eye(len(K)), G), samples.field)


def test_tiles_say_of_biases_what_the_whole_says():
    surveys, _ = walks(6, n=40)
    _, samples, whole = solved(surveys)
    tiling = Tiling(NUMBERS.spacing, margin=5, reach=2, core=6, blend=1)
    tiled = TiledModel.over(samples.positions, NUMBERS, tiling).fit(samples.positions, samples.field, {}, None)
    assert len(tiled.tiles) > 1
    found = solve_biases(tiled, AS_IS, samples, surveys, range(6), SPREAD, attitude_sd=0.0)
    # Tiles do not know that the constant field is one.
    apart = found.bias - whole.bias
    apart[:, 2] -= apart[:, 2].mean()
    assert (np.abs(apart) < 0.2e-6 + whole.sd).all()
    assert np.median(np.abs(apart)) < 0.1e-6


def test_known_biases_of_several_logs_are_recovered_with_their_map(mapped):
    field_map, surveys, biases = mapped
    error = field_map.biases.bias - biases
    assert np.sqrt((error[:, :2] ** 2).mean()) < 0.1 * SPREAD
    assert (np.abs(error) < 3 * field_map.biases.sd).all()
    # The vertical of level walks is known against one another.
    assert np.std(error[:, 2]) < 0.1 * SPREAD
    assert 0.5 * SPREAD < field_map.biases.spread < 1.5 * SPREAD
    assert field_map.hyperparameters.noise_sd < 4e-7
    np.testing.assert_array_equal(
        field_map.surveys[0].field, surveys[0].field - surveys[0].orientations.apply(field_map.biases.bias[0])
    )
    np.testing.assert_allclose(field_map.measured.field, surveys[0].merged(*surveys[1:]).field, rtol=0, atol=1e-15)


def lanes(rng, turn, jitter, bias, n_lanes=7, n=60):
    """A robot's lanes over a room of 4 m, turned by ``turn`` from lane to lane; its orientations are known badly."""
    x = np.linspace(0, 4, n)
    along = [np.c_[x[:: (-1) ** k], np.full(n, 4 * k / (n_lanes - 1)), np.zeros(n)] for k in range(n_lanes)]
    p = np.concatenate(along)
    heading = np.repeat(turn * (np.arange(n_lanes) % 2), n)
    error = Rotation.from_rotvec(rng.normal(0, jitter, (len(p), 3)))
    R = Rotation.from_euler("z", heading[:, None])
    field = field_at(p) + R.apply(bias) + rng.normal(0, 2e-7, p.shape)
    # It measures in its own axes, and turns that into the map's by what it believes of them.
    return Survey(p, error.apply(field), np.arange(len(p)) * 0.1, error * R, name="robot")


@pytest.fixture(scope="module")
def robot():
    """A robot with hard iron along x, and the map of its lanes."""
    survey = lanes(np.random.default_rng(0), np.pi, 0.005, np.array([-3e-6, 0.0, 0.0]))
    return survey, build_map(survey, SPLINE)


def test_one_robots_hard_iron_is_solved_with_its_map(robot):
    survey, field_map = robot
    np.testing.assert_allclose(field_map.biases.bias[0, 0], -3e-6, atol=0.3e-6)
    # What alternates across the lanes may as well be the field's.
    assert (np.abs(field_map.biases.bias[0] - [-3e-6, 0.0, 0.0]) < 3 * field_map.biases.sd[0]).all()
    # Between lanes nothing was measured, and what alternates from lane to lane is taken for a field there.
    beside = np.c_[np.linspace(0.5, 3.5, 20), np.full(20, 4 / 12 * 5), np.zeros(20)]
    with_bias = build_map(survey, FieldConfig(prior="spline", sensor_bias_sd=0.0))
    wrong, right = (
        np.sqrt(((one.evaluate(beside).field - field_at(beside)) ** 2).mean()) for one in (with_bias, field_map)
    )
    assert right < 0.5 * wrong


def test_where_no_orientations_are_known_a_robot_faces_where_it_moves(robot):
    survey, field_map = robot
    bare = build_map(replace(survey, orientations=None), SPLINE).biases
    np.testing.assert_allclose(bare.bias[0, 0], field_map.biases.bias[0, 0], atol=0.2e-6)


def test_the_direction_of_travel_turns_with_the_survey(robot):
    survey = replace(robot[0], orientations=None)
    T = RigidTransform.from_components([3, -2, 1], Rotation.from_rotvec([0.4, -0.9, 1.3]))
    apart = (T.rotation * sensor_axes(survey)).inv() * sensor_axes(survey.transformed(T))
    assert apart.magnitude().max() < 1e-6


def test_what_is_known_of_a_bias_is_taken_out_beside_what_is_not(robot):
    found = build_map(robot[0], FieldConfig(prior="spline", sensor_bias_sd=3e-5)).biases
    assert found.sd[0, 2] > 1e-5
    assert abs(found.bias[0, 0] + 3e-6) < 3 * found.sd[0, 0] < 3e-6


def test_the_axes_of_travel_do_not_hang_on_the_last_samples(robot):
    survey = replace(robot[0], orientations=None)
    for last in (7, 20, 60):
        part = survey.subset(np.arange(len(survey) - last))
        apart = sensor_axes(part).inv() * sensor_axes(survey)[: len(part)]
        assert np.median(apart.magnitude()) < 0.01


def test_errors_of_orientations_are_no_hard_iron():
    survey = lanes(np.random.default_rng(1), 0.0, 0.03, np.zeros(3))
    assert build_map(survey, SPLINE).biases is None


@pytest.mark.parametrize("change", ["unordered", "told"])
def test_a_map_without_biases_to_solve_is_the_same_to_the_bit(change):
    surveys, _ = walks(3, n=30)
    if change == "unordered":
        surveys = [unordered(survey) for survey in surveys]
    config = FieldConfig(prior="spline", sensor_bias_sd=0.0 if change == "told" else None)
    field_map = build_map(surveys, config)
    assert field_map.biases is None
    merged = surveys[0].merged(*surveys[1:])
    np.testing.assert_array_equal(field_map.survey.field, merged.field)
    np.testing.assert_array_equal(field_map.posterior.weights, build_map(merged, config).posterior.weights)


def test_samples_of_which_nobody_knows_how_they_were_turned_tell_the_others_their_bias():
    surveys, biases = walks(6)
    bare = unordered(walk(np.random.default_rng(7), np.zeros(3), n=200))
    found = solved([*surveys, bare])[2]
    assert not found.bias[-1].any()
    np.testing.assert_allclose(found.bias[:-1], biases, atol=1.5e-6)


def test_a_log_added_to_a_map_has_its_bias_solved_against_it(mapped, tmp_path):
    field_map, _, _ = mapped
    bias = np.array([6e-6, -7e-6, 4e-6])
    new = walk(np.random.default_rng(5), bias, n=40)
    grown = field_map.with_surveys(new)
    clean = walk(np.random.default_rng(5), np.zeros(3), n=40)
    np.testing.assert_array_equal(grown.biases.bias[:-1], field_map.biases.bias)
    shared = (grown.survey.field[-40:] - clean.field).mean(axis=0)  # what the map's own logs left to its field
    np.testing.assert_allclose(grown.biases.bias[-1][:2], bias[:2], atol=0.6e-6)
    np.testing.assert_allclose(grown.biases.bias[-1][2] + shared[2], bias[2], atol=0.6e-6)
    grown.save(tmp_path / "room.map")
    loaded = FieldMap.load(tmp_path / "room.map")
    np.testing.assert_array_equal(loaded.biases.bias, grown.biases.bias)
    assert loaded.biases.spread == grown.biases.spread
    assert loaded.transformed(RigidTransform.from_translation([1, 0, 0])).biases is loaded.biases


def test_a_sensor_in_a_map_of_biased_sensors_may_be_as_biased_as_those(mapped):
    known, config = KnownMap.of(mapped[0]), LocalizerConfig()
    assert known.bias_sds(config) == (np.hypot(config.calibrated_bias_sd, mapped[0].biases.spread), config.bias_sd)


def test_info_lists_each_logs_bias_in_microtesla():
    found = SensorBiases(np.array([[1e-6, -2e-6, 3e-6]]), np.full((1, 3), 1e-7), 4e-6)
    said = info_table(found.facts([Survey(np.zeros((1, 3)), np.zeros((1, 3)), name="monday.csv")]))
    assert said.splitlines() == ["sensor bias spread  4 uT", "bias of monday.csv  1, -2, 3 uT (sd 0.1, 0.1, 0.1 uT)"]


@pytest.mark.parametrize(
    "rows",
    [{"bias": np.zeros((2, 2))}, {"sd": np.zeros((1, 3))}, {"bias": np.full((2, 3), np.nan)}, {"spread": -1.0}],
)
def test_biases_that_no_map_can_have_are_refused(rows):
    with pytest.raises(ValueError, match="expected"):
        replace(no_biases(2), **rows)
