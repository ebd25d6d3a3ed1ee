# SPDX-License-Identifier: BSD-3-Clause
"""Poses from elsewhere are weighed by the posterior of a registration: alone, or beside what the search found."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from hand_made import exp_se3, log_se3
from magmatch.errors import ConfigurationError
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.field.config import SPLINE
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.search.candidate import SearchResult
from magmatch.simulation.config import SimulationConfig


class Place:
    """Maps of a pair, and its registration."""

    def __init__(self, scenario, seed, n_samples, *, is_walk=False):
        pair = mm.simulate(scenario, seed, SimulationConfig(n_samples=n_samples))
        # Prepared once for all that is asked of it.
        self.base, self.T = (
            prepare_index(mm.build_map(pair.base, SPLINE)),
            pair.T_base_target,
        )
        self.target = pair.target.subset(np.arange(250)) if is_walk else mm.build_map(pair.target, SPLINE)
        self.center = pair.target.centroid
        self.found = mm.register(self.base, self.target)


@pytest.fixture(scope="module")
def place():
    return Place("office-random", 5, 300)


@pytest.fixture(scope="module")
def walk():
    return Place("office-hand-held", 3, 2000, is_walk=True)


def in_sds(result, other):
    step = log_se3(result.T_base_target.inv() * other.T_base_target)
    return np.abs(step / np.sqrt(np.diag(result.covariance))).max()


@pytest.mark.parametrize("kind", ["place", pytest.param("walk", marks=pytest.mark.slow)])
def test_judging_an_accepted_pose_gives_it_again_with_its_probability(kind, request):
    place = request.getfixturevalue(kind)
    assert place.found.is_accepted
    again = mm.judge(place.base, place.target, [place.found.T_base_target])
    assert again.is_accepted
    # Refinement stops where a step no longer matters, wherever it started.
    assert in_sds(place.found, again) < 0.1
    assert again.probability == pytest.approx(place.found.probability, abs=1e-3)
    np.testing.assert_allclose(np.diag(again.covariance), np.diag(place.found.covariance), rtol=0.1)


def test_a_pose_that_is_near_is_refined(place):
    rough = place.T * exp_se3(np.array([0.02, -0.01, 0.03, 0.04, 0.05, -0.03]))
    result = mm.judge(place.base, place.target, [rough])
    assert result.is_accepted
    assert transform_error(result.T_base_target, place.T, place.center)[0] < 0.03


def test_wrong_poses_are_refused_near_and_far(place):
    wrong, other = (random_transform(np.random.default_rng(seed)) for seed in (1, 2))
    away = RigidTransform.from_translation([1e3, 0, 0]) * place.T
    turned = place.T * exp_se3(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    for poses in ([wrong], [away], [other, away, turned]):
        result = mm.judge(place.base, place.target, poses)
        if result.is_accepted:  # refinement may lead from there to the truth
            assert transform_error(result.T_base_target, place.T, place.center)[0] < 0.1
        else:
            assert result.T_base_target is None
            assert result.reason


def test_the_order_of_candidates_and_wrong_ones_among_them_do_not_matter(place):
    rng = np.random.default_rng(7)
    poses = [*(random_transform(rng) for _ in range(3)), place.found.T_base_target]
    for some in (poses, poses[::-1]):
        result = mm.judge(place.base, place.target, some)
        assert result.is_accepted
        assert in_sds(place.found, result) < 0.1


def test_candidates_never_make_a_right_answer_wrong(place):
    rng = np.random.default_rng(8)
    wrong = [random_transform(rng) for _ in range(3)]
    for candidates in (wrong, [*wrong, place.T]):
        result = mm.register(place.base, place.target, candidates=candidates)
        assert result.is_accepted
        assert in_sds(place.found, result) < 0.1
        assert result.probability == pytest.approx(place.found.probability, abs=1e-3)


def test_a_candidate_supplies_what_the_search_missed(place, monkeypatch):
    monkeypatch.setattr("magmatch.registration.map_strategy.invariant_search", lambda *_: SearchResult())
    result = mm.register(place.base, place.target, mm.RegistrationConfig(search="invariants"), candidates=[place.T])
    assert result.is_accepted
    assert transform_error(result.T_base_target, place.T, place.center)[0] < 0.05


def test_two_poses_that_fit_alike_are_ambiguous():
    """Three equal rooms in a row: one pose alone is sure, its twin beside it is a rival."""
    pair = mm.simulate("repeated", 2, SimulationConfig(n_samples=900))
    base, target = mm.build_map(pair.base, SPLINE), mm.build_map(pair.target, SPLINE)
    along = pair.config.room_size[0] * pair.base.principal_frame().rotation.as_matrix()[:, 0]
    twin = RigidTransform.from_translation(along) * pair.T_base_target
    result = mm.judge(base, target, [pair.T_base_target, twin])
    assert result.status is mm.Status.AMBIGUOUS
    assert len(result.alternatives) == 2


def test_a_wrong_prior_does_not_force_a_wrong_answer(place):
    wrong = place.T * RigidTransform.from_components([1.2, 0.9, 0.0], Rotation.from_euler("z", 120, degrees=True))
    numbers = (*map(float, wrong.translation), *map(float, wrong.rotation.as_quat()))
    known_roughly = PosePriorConfig(pose=numbers, sd_translation=0.2, sd_rotation=0.1)
    for prior in (known_roughly, PosePriorConfig(is_gravity_aligned=True)):
        assert not mm.register(place.base, place.target, mm.RegistrationConfig(prior=prior)).is_accepted


def test_no_candidate_is_a_result_with_a_status(place):
    result = mm.judge(place.base, place.target, [])
    assert result.status is mm.Status.UNINFORMATIVE
    assert result.T_base_target is None
    assert mm.register(place.base, place.target, candidates=[]).is_accepted


@pytest.mark.parametrize(
    ("candidates", "error", "words"),
    [
        (RigidTransform.identity(), TypeError, "give a list of RigidTransform"),
        ([np.eye(4)], TypeError, r"candidates\[0\]: .*RigidTransform.from_matrix"),
        ([RigidTransform.identity(), None], TypeError, r"candidates\[1\]"),
        ([RigidTransform.from_translation(np.zeros((2, 3)))], ValueError, "one RigidTransform"),
        ([RigidTransform.from_translation([np.nan, 0, 0])], ValueError, "expected finite numbers"),
        ("poses.txt", TypeError, "candidates: expected list or tuple"),
    ],
)
def test_poses_that_are_no_transforms_are_refused(place, candidates, error, words):
    for ask in (mm.judge, lambda base, target, poses: mm.register(base, target, candidates=poses)):
        with pytest.raises(error, match=words):
            ask(place.base, place.target, candidates)


def test_the_published_method_takes_no_candidates_and_a_folder_none_either(place, tmp_path):
    with pytest.raises(ConfigurationError, match="weighs no poses but its own"):
        mm.judge(place.base, place.target, [place.T], mm.PRESETS["paper"])
    for name in ("room.map", "same.map"):
        place.base.field_map.save(tmp_path / name)
    with pytest.raises(ConfigurationError, match="give one map as the base"):
        mm.register(tmp_path, place.target, candidates=[place.T])
