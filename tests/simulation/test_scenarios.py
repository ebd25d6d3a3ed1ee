# SPDX-License-Identifier: BSD-3-Clause
"""What each scenario promises: frames, overlap, heights, and whether there is anything to find."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.errors import ConfigurationError
from magmatch.geometry import rotate_vectors, transform_points
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import field_of
from magmatch.simulation.scenarios import ROBOT_HEIGHT, SCENARIOS, build_scene
from magmatch.simulation.scene import Streams
from magmatch.simulation.simulate import simulate

SETTINGS = settings(deadline=None, max_examples=4)
SAME_PLACE = sorted(set(SCENARIOS) - {"nowhere"})
ROOMS = ("office", "office-x30", "office-random", "office-overlap", "planar", "nowhere")


def scene_of(scenario, seed=0, **settings_):
    return build_scene(scenario, SimulationConfig(**settings_), Streams(seed))


def target_in_base(pair):
    return transform_points(pair.target.positions, pair.T_base_target)


@pytest.mark.parametrize("scenario", SAME_PLACE)
@SETTINGS
@given(seed=st.integers(0, 2**31))
def test_target_field_turned_by_the_truth_is_the_base_field_there(scenario, seed):
    exact = SimulationConfig(n_samples=60, noise_sd=0.0, pose_drift=0.0)
    pair, scene = simulate(scenario, seed, exact), build_scene(scenario, exact, Streams(seed))
    turned = rotate_vectors(pair.target.field, pair.T_base_target)
    there = scene.base_field(target_in_base(pair))
    # The closed form of a magnet rounds at its polarisation, 0.4 T under the table, not at the field of 5e-5 T.
    relative = 1e-12 if scenario.startswith("office") or scenario == "planar" else 1e-11
    np.testing.assert_allclose(turned, there, rtol=0, atol=relative * np.linalg.norm(there, axis=1).max())


def test_earth_field_is_added_once(exact):
    pair = simulate("uniform", 0, exact)
    np.testing.assert_array_equal(pair.base.field, np.tile(exact.earth_field, (200, 1)))
    scene = build_scene("office", exact, Streams(0))
    points = scene.base_path.positions
    anomaly = scene.base_field(points) - field_of(scene.base_sources, points)
    np.testing.assert_allclose(anomaly, np.tile(exact.earth_field, (200, 1)), atol=1e-18)


@pytest.mark.parametrize("scenario", ROOMS)
def test_room_sources_stay_clear_of_both_surveys(scenario):
    scene = scene_of(scenario, n_samples=500)
    for sources, path in ((scene.base_sources, scene.base_path), (scene.target_sources, scene.target_path)):
        assert min(source.distance_to(path.positions).min() for source in sources) >= 0.3 - 1e-9


def test_office_inside_has_furniture_in_the_room_that_samples_keep_off():
    scene = scene_of("office-inside")
    is_inside = [(np.abs(source.center) < (1.5, 1.5, 0.5)).all() for source in scene.base_sources]
    assert sum(is_inside) == 5
    for path in (scene.base_path, scene.target_path):
        assert min(source.distance_to(path.positions).min() for source in scene.base_sources) >= 0.15


@pytest.mark.parametrize("scenario", ["table", "table-robot"])
def test_magnets_are_below_the_table_and_sensors_above(scenario):
    scene = scene_of(scenario)
    assert 10 <= len(scene.base_sources) <= 20
    assert all(source.center[2] < 0 for source in scene.base_sources)
    for path in (scene.base_path, scene.target_path):
        assert path.positions[:, 2].min() > 0.02


@pytest.mark.parametrize(
    ("scenario", "axis", "angle"), [("office", "z", 30), ("office-z30", "z", 30), ("office-x30", "x", -30)]
)
def test_published_office_is_turned_by_the_published_angle(scenario, axis, angle):
    truth = scene_of(scenario, seed=4).T_base_target.rotation
    assert (truth.inv() * Rotation.from_euler(axis, angle, degrees=True)).magnitude() < 1e-12


def test_table_target_is_framed_by_its_first_sensor_pose():
    pair = simulate("table", 2)
    np.testing.assert_allclose(pair.target.positions[0], 0, atol=1e-12)
    assert pair.target.orientations[0].magnitude() < 1e-12
    expected = Rotation.from_euler("z", 20, degrees=True) * Rotation.from_euler("y", 20, degrees=True)
    assert (pair.T_base_target.rotation.inv() * expected).magnitude() < 1e-12
    first_pose = scene_of("table", 2).target_path.positions[0]
    np.testing.assert_allclose(pair.T_base_target.translation, first_pose, atol=1e-12)


def test_robot_drives_at_fixed_height_looking_ahead():
    scene = scene_of("table-robot")
    positions, orientations = scene.target_path.positions, scene.target_path.orientations
    np.testing.assert_allclose(positions[:, 2], ROBOT_HEIGHT, atol=1e-12)
    assert (np.abs(positions[:, :2]) < (1.0, 0.75)).all()
    ahead = orientations.apply([1.0, 0, 0])[1:-1]
    travel = positions[2:] - positions[:-2]
    assert np.median(np.einsum("ij,ij->i", ahead, travel) / np.linalg.norm(travel, axis=1)) > 0.999


def test_corridor_passes_run_side_by_side():
    scene = scene_of("corridor")
    base, target = scene.base_path.positions, scene.target_path.positions
    apart = np.linalg.norm(base[::2, None] - target[None, ::10], axis=2).min(axis=0)
    # Millimetres for samples that do not lie straight across from each other.
    assert apart[10:-10].min() > 0.095
    assert apart[10:-10].max() < 0.405


def test_corridor_frames_are_upright_unless_asked_otherwise():
    upright = [scene_of("corridor", seed).T_base_target.rotation.as_matrix()[2, 2] for seed in range(4)]
    np.testing.assert_allclose(upright, 1, atol=1e-12)
    tilted = [
        scene_of("corridor", seed, target_frame="any").T_base_target.rotation.as_matrix()[2, 2] for seed in range(4)
    ]
    assert min(tilted) < 0.9


@pytest.mark.parametrize("overlap", [0.125, 1.0])
def test_overlap_is_the_fraction_of_the_target_that_the_base_covers(overlap):
    scene = scene_of("office-overlap", overlap=overlap, n_samples=4000)
    low, high = scene.base_path.positions.min(axis=0), scene.base_path.positions.max(axis=0)
    is_covered = ((scene.target_path.positions >= low) & (scene.target_path.positions <= high)).all(axis=1)
    assert is_covered.mean() == pytest.approx(overlap, abs=0.03)  # four standard errors


def test_repeated_rooms_cannot_be_told_apart():
    scene = scene_of("repeated")
    points = scene.target_path.positions[:500]
    field = scene.base_field(points)
    for shift in (-3.0, 3.0):
        # Well below the noise of 0.4 uT: the row goes on three rooms beyond the base's ends.
        assert np.abs(scene.base_field(points + np.array([shift, 0, 0])) - field).max() < 0.2e-6


def test_moved_sources_change_the_target_only():
    before, after = scene_of("office", 1), scene_of("office", 1, moved_sources=0.3)
    points = before.target_path.positions[:200]
    np.testing.assert_array_equal(field_of(before.base_sources, points), field_of(after.base_sources, points))
    change = field_of(after.target_sources, points) - field_of(before.target_sources, points)
    assert np.linalg.norm(change, axis=1).max() > 1e-6
    assert after.accept
    assert not scene_of("office", 1, moved_sources=0.9).accept


def test_first_pose_without_a_path_is_refused():
    with pytest.raises(ConfigurationError, match="needs a scenario whose target is a path"):
        simulate("office", config=SimulationConfig(target_frame="first_pose"))


@pytest.mark.parametrize("angle", [0.5, np.pi])
def test_target_is_turned_by_the_angle_asked_for(angle, exact):
    axes = []
    for seed in range(2):
        T = simulate("office-random", seed, exact.model_copy(update={"target_turn": angle})).T_base_target
        assert T.rotation.magnitude() == pytest.approx(angle, abs=1e-9)
        axes.append(T.rotation.as_rotvec())
    assert not np.allclose(np.cross(*axes), 0)


def test_planes_are_as_far_apart_as_asked_for(exact):
    gap = exact.model_copy(update={"plane_gap": 0.4, "target_turn": 0.0})
    pair = simulate("planar", 0, gap)
    p_base = pair.T_base_target.apply(pair.target.positions)
    assert p_base[:, 2].mean() - pair.base.positions[:, 2].mean() == pytest.approx(0.4, abs=0.005)
