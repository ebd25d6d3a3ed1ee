# SPDX-License-Identifier: BSD-3-Clause
"""Measuring and writing: determinism, noise, sensor errors, files."""

import json
from importlib.resources import files

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from magmatch.errors import ConfigurationError
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scenarios import SCENARIOS, build_scene
from magmatch.simulation.scene import Streams
from magmatch.simulation.simulate import simulate, write_pair


@pytest.mark.parametrize("scenario", sorted(SCENARIOS))
def test_same_seed_gives_the_same_bits(scenario):
    config = SimulationConfig(n_samples=100, pose_noise_sd=0.01, moved_sources=0.2)
    first, second = simulate(scenario, 7, config), simulate(scenario, 7, config)
    for name in ("base", "target"):
        a, b = getattr(first, name), getattr(second, name)
        assert a.positions.tobytes() == b.positions.tobytes()
        assert a.field.tobytes() == b.field.tobytes()
    assert first.T_base_target.as_matrix().tobytes() == second.T_base_target.as_matrix().tobytes()


def test_settings_of_the_errors_leave_the_place_as_it_was(exact):
    clean = simulate("office", 0, exact)
    noisy = simulate("office", 0, exact.model_copy(update={"noise_sd": 1e-6, "bias": (1e-6, 0.0, 0.0)}))
    np.testing.assert_array_equal(clean.base.positions, noisy.base.positions)
    assert np.abs(clean.target.field - noisy.target.field).max() < 8e-6


def test_noise_is_white_with_its_deviation_and_differs_between_surveys():
    config = SimulationConfig(n_samples=2000, noise_sd=0.5e-6)
    noisy, clean = simulate("office", 0, config), simulate("office", 0, config.model_copy(update={"noise_sd": 0.0}))
    base = noisy.base.field - clean.base.field
    target = noisy.target.field - clean.target.field
    for noise in (base, target):
        # Five standard errors of mean, deviation and correlation over 2,000 samples.
        assert np.abs(noise.mean(axis=0)).max() < 5 * 0.5e-6 / np.sqrt(2000)
        np.testing.assert_allclose(noise.std(axis=0), 0.5e-6, rtol=5 / np.sqrt(4000))
        assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 5 / np.sqrt(2000)
        assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 5 / np.sqrt(2000)
    assert np.abs(np.corrcoef(base.T, target.T)[:3, 3:]).max() < 5 / np.sqrt(2000)


def test_pose_noise_moves_the_record_not_the_field(exact):
    rough = simulate("office", 0, exact.model_copy(update={"pose_noise_sd": 0.03}))
    clean = simulate("office", 0, exact)
    np.testing.assert_array_equal(rough.base.field, clean.base.field)
    offset = rough.base.positions - clean.base.positions
    assert offset.std() == pytest.approx(0.03, rel=0.15)
    assert rough.base.pose_sd == pytest.approx(0.03)
    assert clean.base.pose_sd == 0


def test_drift_of_the_corridor_is_as_large_as_it_says_and_stays_level():
    drifts = []
    for seed in range(5):
        config = SimulationConfig(n_samples=100, pose_drift=0.02)
        drifting = simulate("corridor", seed, config)
        straight = simulate("corridor", seed, config.model_copy(update={"pose_drift": 0.0}))
        np.testing.assert_array_equal(drifting.base.field, straight.base.field)
        offset = drifting.base.positions - straight.base.positions
        np.testing.assert_allclose(offset.mean(axis=0), 0, atol=1e-12)
        np.testing.assert_allclose(offset[:, 2], 0, atol=1e-12)
        drifts.append(np.sqrt((offset[:, :2] ** 2).mean()))
    # Ten random walks, each with a long-tailed mean square.
    assert np.sqrt(np.mean(np.square(drifts))) == pytest.approx(drifting.base.pose_sd, rel=0.4)


def test_drift_is_for_dead_reckoning_only(exact):
    drifting = simulate("table", 0, exact.model_copy(update={"pose_drift": 0.1}))
    np.testing.assert_array_equal(drifting.target.positions, simulate("table", 0, exact).target.positions)


@pytest.mark.parametrize("scenario", ["office", "table-robot"])
def test_target_magnetometer_reads_scaled_and_biased_in_its_own_frame(scenario, exact):
    bias = np.array([2e-6, -1e-6, 0.5e-6])
    changed = exact.model_copy(update={"bias": tuple(bias), "scale": 0.03, "target_frame": "any"})
    clean = simulate(scenario, 0, exact.model_copy(update={"target_frame": "any"}))
    other = simulate(scenario, 0, changed)
    np.testing.assert_array_equal(other.base.field, clean.base.field)
    offset = other.target.field - 1.03 * clean.target.field
    if scenario == "office":
        # A sensor that did not turn is aligned with the world.
        world_to_target = build_scene(scenario, changed, Streams(0)).T_target_world
        np.testing.assert_allclose(offset, rotate_vectors(np.tile(bias, (200, 1)), world_to_target), atol=1e-15)
    else:
        in_sensor = clean.target.orientations.inv().apply(offset)
        np.testing.assert_allclose(in_sensor, np.tile(bias, (200, 1)), atol=1e-15)


@pytest.mark.parametrize(
    "wrong", [{"n_samples": 3}, {"noise_sd": -1e-9}, {"overlap": 0.0}, {"moved_sources": 1.5}, {"nois": 1}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ConfigurationError):
        SimulationConfig(**wrong)


def test_written_pair_reads_back_bit_for_bit(tmp_path):
    pair = simulate("table", 2, SimulationConfig(n_samples=40))
    folder = tmp_path / "a" / "b"
    write_pair(pair, folder)
    assert sorted(file.name for file in folder.iterdir()) == ["base.csv", "target.csv", "truth.json"]
    for name in ("base", "target"):
        written, survey = mm.read_survey(folder / f"{name}.csv"), getattr(pair, name)
        np.testing.assert_array_equal(written.positions, survey.positions)
        np.testing.assert_array_equal(written.field, survey.field)
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["accept"] is True
    assert (truth["scenario"], truth["seed"], truth["version"]) == ("table", 2, mm.__version__)
    np.testing.assert_array_equal(truth["T_base_target"], pair.T_base_target.as_matrix())
    assert SimulationConfig(**truth["config"]) == pair.config


def test_packaged_office_is_small_and_its_truth_holds():
    office = files("magmatch.data") / "samples" / "office"
    sizes = [len((office / name).read_bytes()) for name in ("base.csv", "target.csv", "truth.json")]
    assert sum(sizes) < 300_000
    base, target = mm.read_survey(office / "base.csv"), mm.read_survey(office / "target.csv")
    assert len(base) == len(target) == 1500
    truth = json.loads((office / "truth.json").read_text())
    assert truth["accept"]
    T_base_target = RigidTransform.from_matrix(np.array(truth["T_base_target"]))
    config = SimulationConfig(**truth["config"])
    scene = build_scene(truth["scenario"], config, Streams(truth["seed"]))
    p_base = transform_points(target.positions, T_base_target)
    residual = rotate_vectors(target.field, T_base_target) - scene.base_field(p_base)
    assert residual.std() == pytest.approx(config.noise_sd, rel=0.06)  # five standard errors
