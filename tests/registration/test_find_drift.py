# SPDX-License-Identifier: BSD-3-Clause
"""A walk that drifts is told by its halves; one that does not, or is of another place, is not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.geometry import path_walked
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.find_drift import naming_drift
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.prepared.walk import is_line
from magmatch.registration.result import Alternative, RegistrationResult, Status
from magmatch.registration.steps import register_once
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate

CONFIG = RegistrationConfig(search="pairs")
ROWS = np.arange(240)


def made(seed):
    return simulate("office-hand-held", seed, SimulationConfig(n_samples=2000))


@pytest.fixture(scope="module")
def base():
    return prepare_index(build_map(made(3).base), CONFIG)


def bent(walk, degrees):
    """The same walk, its second half turned about where it begins, as dead reckoning turns it: poses and vectors."""
    half = len(walk) // 2
    turn, joint = Rotation.from_euler("z", degrees, degrees=True), walk.positions[half]
    moved = walk.transformed(RigidTransform.from_components(joint - turn.apply(joint), turn))
    parts = ((getattr(walk, name)[:half], getattr(moved, name)[half:]) for name in ("positions", "field"))
    return Survey(*map(np.concatenate, parts))


def answered(base, walk):
    return register_once(base, walk, walk, CONFIG, 0, Clock())[2]


def test_a_walk_that_bends_in_the_middle_is_refused_and_drift_is_named_with_its_size(base):
    answer = answered(base, bent(made(3).target.subset(ROWS), 8.0))
    assert not answer.is_accepted
    # First, since what a single pose lacks follows from it.
    assert answer.reason.startswith("the target's positions or orientations drift")
    (turn,) = re.findall(r"(\d+) deg apart where they meet", answer.reason)
    assert abs(int(turn) - 8) <= 1


def test_drift_is_named_of_a_path_that_fills_an_area_and_of_no_other_place(base):
    refused = RegistrationResult(
        Status.INCONSISTENT, "no", None, alternatives=(Alternative(RigidTransform.identity(), 0.5),)
    )
    here, elsewhere = (bent(made(seed).target, 8.0) for seed in (3, 8))
    assert not is_line(here, base.length)
    named = naming_drift(refused, base, here, RegistrationConfig())
    assert named.reason.startswith("the target's positions or orientations drift: its halves fit poses")
    assert naming_drift(refused, base, elsewhere, RegistrationConfig()) is refused
    # Samples in no order have no halves.
    shuffled = here.subset(np.random.default_rng(0).permutation(len(here)))
    assert naming_drift(refused, base, shuffled, RegistrationConfig()) is refused


def test_of_an_answer_beside_a_change_drift_is_named_if_it_explains_the_residuals_better(base):
    straight = made(3).target.subset(ROWS)
    found = answered(base, straight)
    # As if what residuals a single pose leaves had been taken for iron that moved.
    beside = replace(found, evidence=found.evidence | {"unchanged": 0.8, "effective": 20.0})
    assert naming_drift(found, base, bent(straight, 8.0), CONFIG) is found
    assert naming_drift(beside, base, straight, CONFIG) is beside
    refused = naming_drift(beside, base, bent(straight, 8.0), CONFIG)
    assert refused.status is Status.INCONSISTENT
    assert "drift" in refused.reason
    assert (refused.T_base_target, refused.covariance) == (None, None)
    assert refused.probability < 0.01
    assert refused.alternatives[0].T_base_target is found.T_base_target


def test_of_an_answer_beside_a_change_one_half_that_fits_elsewhere_is_enough(base):
    straight, other = made(3).target.subset(ROWS), made(8).target.subset(ROWS)
    found, half = answered(base, straight), len(straight) // 2
    # The first half is of another place.
    parts = ((getattr(other, name)[:half], getattr(straight, name)[half:]) for name in ("positions", "field"))
    walk = Survey(*map(np.concatenate, parts))
    beside = replace(found, evidence=found.evidence | {"unchanged": 0.8, "effective": 10.0})
    assert naming_drift(beside, base, walk, CONFIG) is beside
    away = found.T_base_target * RigidTransform.from_rotation(Rotation.from_euler("z", 30, degrees=True))
    refused = naming_drift(replace(beside, T_base_target=away), base, walk, CONFIG)
    assert refused.status is Status.INCONSISTENT
    assert "one half alone fits a pose" in refused.reason
    # Of a refusal it says nothing: what the other half passed may have changed, or be of another place.
    unsure = replace(beside, status=Status.AMBIGUOUS, T_base_target=None, alternatives=(Alternative(away, 0.5),))
    assert naming_drift(unsure, base, walk, CONFIG) is unsure


def turning(survey, degrees):
    """The same survey by dead reckoning whose heading drifts steadily, by so much in all."""
    walked = path_walked(survey.positions)
    turn = Rotation.from_euler("z", np.radians(degrees) * (walked / walked[-1] - 0.5)[:, None])
    steps = turn[1:].apply(np.diff(survey.positions, axis=0))
    return Survey(np.concatenate([[np.zeros(3)], np.cumsum(steps, axis=0)]), turn.apply(survey.field))


@pytest.mark.slow
def test_a_survey_compared_as_a_map_is_known_no_better_than_its_drift_lets_it():
    pair, config = made(3), RegistrationConfig(search="invariants")
    base = prepare_index(build_map(pair.base), config)
    straight, turned = (
        register_once(base, one, one, config, 0, Clock())[2] for one in (pair.target, turning(pair.target, 10.0))
    )
    assert straight.is_accepted
    assert "drift" not in straight.reason
    assert turned.is_accepted
    assert turned.reason.startswith("probability")
    # Its halves differ by half of the whole turn.
    (turn,) = re.findall(r"(\d+) deg apart", turned.reason)
    assert abs(int(turn) - 5) <= 1
    assert np.degrees(turned.standard_deviations[0]) > 10.0 / np.sqrt(12) * 0.8


def test_where_drift_leaves_a_pose_too_uncertain_it_is_named_first():
    pair, config = made(3), RegistrationConfig(search="invariants")
    base, target = prepare_index(build_map(pair.base), config), turning(pair.target, 20.0)
    refused = register_once(base, target, target, config, 0, Clock())[2]
    assert refused.status is Status.DEGENERATE
    assert refused.reason.startswith("the target's positions or orientations drift")


def test_drift_is_not_named_of_a_bent_walk_of_another_place(base):
    elsewhere = answered(base, bent(made(8).target.subset(ROWS), 8.0))
    assert not elsewhere.is_accepted
    assert "drift" not in elsewhere.reason


def test_a_straight_walk_that_was_refused_is_not_said_to_drift_nor_one_without_a_pose(base):
    walk = made(3).target.subset(ROWS)
    found = answered(base, walk)
    assert found.is_accepted
    without = replace(found, status=Status.UNINFORMATIVE, T_base_target=None, alternatives=())
    assert naming_drift(without, base, walk, CONFIG) is without
    # Refused by a stricter demand, at the very pose that was right.
    strict = RegistrationConfig(search="pairs", decision={"max_sd_translation": 1e-6})
    refused = register_once(base, walk, walk, strict, 0, Clock())[2]
    assert refused.best_pose is not None
    assert not refused.is_accepted
    assert "drift" not in refused.reason


def test_a_walk_that_bends_a_little_is_accepted_with_as_much_more_spread(base):
    straight = made(3).target.subset(ROWS)
    rigid, drifting = answered(base, straight), answered(base, bent(straight, 2.0))
    assert rigid.is_accepted
    assert "drift" not in rigid.reason
    assert drifting.is_accepted
    assert "drift" in drifting.reason
    assert drifting.standard_deviations[0] > 1.5 * rigid.standard_deviations[0]
