"""The whole path on a small office: two surveys in, one transform out, whatever the frames."""

import numpy as np
import pytest

import magmatch as mm
from hand_made import log_se3
from magmatch.field.config import SPLINE
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.config import PRESETS
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.refine_and_weigh_walk import weigh_walk
from magmatch.simulation.config import SimulationConfig

pytest.importorskip("magpylib", reason="needs the extra 'simulation'")

SMALL = SimulationConfig(n_samples=900)


@pytest.fixture(scope="module")
def office():
    pair = mm.simulate("office-random", 11, SMALL)
    base_map, target_map = mm.build_map(pair.base, SPLINE), mm.build_map(pair.target, SPLINE)
    return pair, base_map, target_map, mm.register(base_map, target_map)


def test_two_surveys_of_a_room_are_registered(office):
    pair, _, _, result = office
    distance, angle = transform_error(result.T_base_target, pair.T_base_target, pair.target.centroid)
    assert result.status == "accepted"
    assert distance < 0.005
    assert angle < np.radians(0.3)


def test_carried_grids_give_the_carried_answer_to_rounding(office):
    # register(T1 base, T2 target) = T1 T T2^-1: maps, grids and random choices move with their surveys.
    _, base_map, target_map, result = office
    rng = np.random.default_rng(0)
    T1, T2 = random_transform(rng, 1.0), random_transform(rng, 1.0)
    moved = mm.register(base_map.transformed(T1), target_map.transformed(T2))
    expected = T1 * result.T_base_target * T2.inv()
    np.testing.assert_allclose(moved.T_base_target.as_matrix(), expected.as_matrix(), atol=1e-9)


def test_surveys_in_other_frames_give_the_same_answer_within_its_covariance(office):
    pair, _, _, result = office
    rng = np.random.default_rng(1)
    T1, T2 = random_transform(rng), random_transform(rng)
    moved = mm.register(pair.base.transformed(T1), pair.target.transformed(T2))
    back = T1.inv() * moved.T_base_target * T2
    xi = log_se3(result.T_base_target.inv() * back)
    assert xi @ np.linalg.solve(result.covariance, xi) < 6.0


@pytest.mark.slow
def test_walks_along_the_path_of_another_are_refined_from_both_sides():
    errors = []
    for seed in (301, 302, 303):
        pair = mm.simulate("corridor", seed)
        base = prepare_index(mm.build_map(pair.base, SPLINE))
        result = mm.register(base, pair.target)
        assert result.is_accepted
        xi = log_se3(result.T_base_target.inv() * pair.T_base_target)
        assert xi @ np.linalg.solve(result.covariance, xi) / 6 < 4.0
        answers = one_sided(base, pair.target), result.T_base_target
        errors.append([transform_error(T, pair.T_base_target, pair.target.centroid) for T in answers])
    (far, turned), (near, hardly) = np.sqrt(np.mean(np.square(errors), axis=0))
    assert near < min(0.15, far / 2)
    assert hardly < turned


def one_sided(index, target):
    """The pose of the target as a walk in the base's map alone."""
    walks = index.walks
    assert not walks.noise.is_learned  # one pass only
    strategy = WalkStrategy(target, target, PRESETS["default"], 0)
    walk = strategy.pair(index)
    starts = strategy.search(walk).poses
    best = weigh_walk(walks.base, walk.target, starts, walks.noise, walk.prior)[0]
    return walk.estimate(best).T_base_target


@pytest.mark.parametrize("scenario", ["nowhere", "uniform"])
def test_what_cannot_be_known_is_refused_with_a_reason(scenario):
    pair = mm.simulate(scenario, 5, SMALL)
    result = mm.register(pair.base, pair.target)
    assert not result.is_accepted
    assert result.T_base_target is None
    assert result.covariance is None
    assert len(result.reason) > 20


@pytest.mark.slow
def test_a_smooth_room_does_not_pass_for_another_with_a_biased_sensor():
    # Once accepted: a wrong pose that a free bias helps to match all that is smooth, at 5 times the maps' spread.
    pair = mm.simulate("nowhere", 211)
    assert not mm.register(pair.base, pair.target).is_accepted


def test_preset_paper_registers_a_room_without_refinement():
    pair = mm.simulate("office-z30", 3, SimulationConfig(n_samples=500))
    result = mm.register(pair.base, pair.target, PRESETS["paper"])
    distance, angle = transform_error(result.T_base_target, pair.T_base_target, pair.target.centroid)
    assert result.is_accepted
    assert result.covariance is None  # the published method gives none
    assert distance < 0.1
    assert angle < np.radians(3)
