# SPDX-License-Identifier: BSD-3-Clause
"""A walk that drifts is told by its halves; one that does not, or is of another place, is not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.halves import naming_drift
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.result import Status
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
    assert "drift" in answer.reason
    (turn,) = re.findall(r"(\d+) deg apart where they meet", answer.reason)
    assert abs(int(turn) - 8) <= 1


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
