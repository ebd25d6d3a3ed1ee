# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePrior, PosePriorConfig
from magmatch.estimation.walk import walk_of
from magmatch.geometry import perturbation, random_transform, transform_error
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import MapIndex, index_walks
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.result import Status
from magmatch.registration.steps import refine_and_weigh, settle_and_decide
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.refine_and_weigh_walk import weigh_walk

NOISE_SD = 0.3e-6
CORNERS = np.array([[0.3, 0.4, 0.3], [2.6, 0.7, 0.2], [2.4, 2.5, 0.35], [0.6, 2.2, 0.3]])


def path(corners, step=0.02):
    legs = [np.linspace(a, b, int(np.linalg.norm(b - a) / step)) for a, b in pairwise(corners)]
    return np.concatenate(legs)


def walk_in(base, rng, corners=CORNERS):
    """A walk measured in the exact base's own world."""
    x = path(corners)
    return Survey(x, base.evaluate(x).field + NOISE_SD * rng.standard_normal(x.shape))


@pytest.fixture(scope="module")
def rooms(make_exact_pair):
    here, elsewhere = make_exact_pair(3, RigidTransform.identity(), other_room=True)
    return here, elsewhere


@pytest.fixture(scope="module")
def index(rooms):
    rng = np.random.default_rng(0)
    return index_walks(prepare(rooms[0], 8, rng), rng)


def register_walk(index, target, seed=0, prior=None):
    """What the base's side alone says of a walk."""
    config = RegistrationConfig(prior=prior or PosePriorConfig())
    strategy = WalkStrategy(target, target, config, seed)
    pair = strategy.pair(MapIndex(index.base, [index]))
    weighed = refine_and_weigh(strategy, pair, strategy.search(pair))
    return settle_and_decide(weighed, config.decision, Clock())


def test_a_walk_is_found_wherever_its_frame_lies(rooms, index):
    rng = np.random.default_rng(0)
    T = random_transform(rng)
    target = walk_in(rooms[0], rng).transformed(T.inv())
    result = register_walk(index, target)
    assert result.status is Status.ACCEPTED, result.reason
    distance, angle = transform_error(result.T_base_target, T, target.centroid)
    assert distance < 0.03
    assert np.degrees(angle) < 1.5


def test_a_walk_in_another_room_is_refused(rooms, index):
    rng = np.random.default_rng(0)
    target = walk_in(rooms[1], rng).transformed(random_transform(rng))
    result = register_walk(index, target)
    assert result.status is not Status.ACCEPTED
    assert result.T_base_target is None
    assert result.reason


def test_a_walk_shorter_than_any_pair_is_refused_with_a_reason(rooms, index):
    rng = np.random.default_rng(1)
    short = walk_in(rooms[0], rng, CORNERS[:1] + np.array([[0, 0, 0], [0.2, 0.0, 0.0]]))
    result = register_walk(index, short)
    assert result.status is Status.UNINFORMATIVE
    assert "survey closer to iron" in result.reason


def test_a_rough_pose_makes_a_short_walk_enough(rooms, index):
    """Half a metre straight on leaves the pose open; a pose known to 10 cm and 4 deg closes it.

    The base must have taught what residuals along a path are like: half a metre is no map of its own.
    """
    index = replace(index, noise=replace(index.noise, n_stretches=20))
    rng = np.random.default_rng(3)
    T = random_transform(rng)
    target = walk_in(rooms[0], rng, np.array([[0.5, 0.6, 0.3], [1.1, 0.7, 0.25]])).transformed(T.inv())
    alone = register_walk(index, target, 0)
    assert not alone.is_accepted
    rough = T * perturbation(np.array([0.04, -0.03, 0.03, 0.06, -0.05, 0.05]), target.centroid)
    numbers = (*map(float, rough.translation), *map(float, rough.rotation.as_quat()))
    prior = PosePriorConfig(pose=numbers, sd_translation=0.05, sd_rotation=0.03)
    result = register_walk(index, target, prior=prior)
    assert result.is_accepted, result.reason
    distance, angle = transform_error(result.T_base_target, T, target.centroid)
    assert distance < 0.05
    assert np.degrees(angle) < 3


def test_a_walk_far_from_a_wrong_rough_pose_is_refused(rooms, index):
    rng = np.random.default_rng(4)
    target = walk_in(rooms[0], rng)
    prior = PosePriorConfig(pose=(0.9, -0.8, 0.3, 0.0, 0.0, 0.7071, 0.7071), sd_translation=0.2, sd_rotation=0.1)
    assert not register_walk(index, target, prior=prior).is_accepted


def test_a_walk_is_found_among_the_headings_that_gravity_leaves(rooms, index):
    rng = np.random.default_rng(6)
    T = RigidTransform.from_components([3.0, -2.0, 0.5], Rotation.from_euler("z", 200, degrees=True))
    prior = PosePriorConfig(is_gravity_aligned=True)
    result = register_walk(index, walk_in(rooms[0], rng).transformed(T.inv()), prior=prior)
    assert result.is_accepted, result.reason
    assert (T.rotation.inv() * result.T_base_target.rotation).magnitude() < 0.02


def test_a_walk_through_a_uniform_field_is_refused(index):
    rng = np.random.default_rng(2)
    x = path(CORNERS)
    uniform = Survey(x, np.array([20e-6, 0.0, -45e-6]) + NOISE_SD * rng.standard_normal(x.shape))
    assert register_walk(index, uniform).status is not Status.ACCEPTED


def test_the_stated_covariance_matches_the_errors(rooms, index):
    """Residuals are drawn from the covariance that is assumed: a mean of 240 chi-squares is 1 +- 0.1."""
    noise = replace(index.noise, misfit_sd=0.8e-6, constant_sd=0.4e-6, attitude_sd=0.01, drift_sd=0.01)
    clean = walk_of(walk_in(rooms[0], np.random.default_rng(0)), index.length)
    truth = index.base.T_map_model.inv() * clean.T_survey_walk
    values = index.base.field_map.posterior.evaluate(truth.apply(clean.positions), 1).rotated(truth.inv())
    sd = index.base.raster.lookup(truth.apply(clean.positions))[1]
    C = noise.full(cdist(clean.positions, clean.positions), sd, values.gradient, values.field)
    L, rng = np.linalg.cholesky(C), np.random.default_rng(4)
    nees = []
    for _ in range(40):
        walk = replace(clean, field=values.field + (L @ rng.standard_normal(len(C))).reshape(-1, 3))
        best = weigh_walk(index.base, walk, [truth], noise, PosePrior(1.0))[0]
        # Perturbation about the centre: turn, then shift of the centre.
        difference = best.T_base_target.inv() * truth
        shift = difference.apply(best.center) - best.center
        xi = np.concatenate([difference.rotation.as_rotvec(), shift])
        nees.append(xi @ np.linalg.solve(best.covariance, xi) / 6)
    assert 0.7 < np.mean(nees) < 1.4
