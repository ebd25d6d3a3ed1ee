# SPDX-License-Identifier: BSD-3-Clause
"""A walk that bends, in a map that passed each place once, and in one that shows how walks drift there."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import log_se3
from magmatch import build_map, register, simulate
from magmatch.estimation.model_prior import EACH_DRIFT, TURNS
from magmatch.estimation.posterior import answers_of
from magmatch.field.config import SPLINE
from magmatch.geometry import transform_error
from magmatch.registration.config import PRESETS
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.bending_walk import BendingWalk, worth_bending
from magmatch.registration.weigh.refine_and_weigh_walk import weigh_walk
from magmatch.simulation.config import SimulationConfig

CONFIG = PRESETS["default"]


@pytest.fixture(scope="module")
def drifting():
    """A corridor walked twice, blind, 5 cm per square root of a metre."""
    pair = simulate("corridor", 401, SimulationConfig(pose_drift=0.05))
    return pair, prepare_index(build_map(pair.base, SPLINE))


def weigher(index, target):
    """The weighing of a walk in a base, and their pair."""
    walks, pair = index.walks, WalkStrategy(target, target, CONFIG, 0).pair(index)
    assert not walks.noise.is_learned  # each place was passed once
    return pair, BendingWalk.of(walks.base, pair.target, walks.noise, pair.prior)


@pytest.mark.slow
def test_a_walk_that_drifts_is_found_with_a_covariance_that_holds_its_drift(drifting):
    pair, index = drifting
    result = register(index, pair.target)
    assert result.is_accepted, result.reason
    xi = log_se3(result.T_base_target.inv() * pair.T_base_target)
    assert xi @ np.linalg.solve(result.covariance, xi) / 6 < 4


def test_the_right_pose_has_evidence_and_one_beside_it_has_none(drifting):
    pair, index = drifting
    models, bending = weigher(index, pair.target)
    truth = models.T_base_model.inv() * pair.T_base_target * models.T_target_model
    found = bending.at_each_drift([truth])
    # One hypothesis for each drift, of one answer.
    assert len({one.model for one in found}) == len(found) == sum(len(turns.rates) for turns in TURNS)
    (answer,), right = answers_of(found, (1.0, 0.3)), found[0]
    assert answer.hypotheses == tuple(found)
    assert right.log_evidence > 20
    assert transform_error(right.T_base_target, truth, right.center)[0] < 0.3
    other = simulate("corridor", 402, SimulationConfig(pose_drift=0.05))
    models, bending = weigher(index, other.target)
    wrong = bending.at_each_drift([models.T_base_model.inv() * pair.T_base_target * models.T_target_model])
    assert all(one.log_evidence < 0 for one in wrong)


def test_by_a_guessed_noise_poses_of_many_maps_are_asked_at_one_drift(drifting, monkeypatch):
    pair, index = drifting
    models, _ = weigher(index, pair.target)
    truth = models.T_base_model.inv() * pair.T_base_target * models.T_target_model
    noise, beside = index.walks.noise, truth * RigidTransform.from_translation([3.0, 0.0, 0.0])
    weighed = weigh_walk(index.walks.base, models.target, [truth, beside], noise, models.prior)
    asked, fit = [], BendingWalk._fit
    monkeypatch.setattr(BendingWalk, "_fit", lambda *args: asked.append(args) or fit(*args))

    def worth(likely, ahead=0.0):
        asked.clear()
        return *worth_bending(index.walks.base, models.target, likely, noise, models.prior, ahead), len(asked)

    right, wrong = (replace(one, attainable=-1.0) for one in weighed)
    # What could match by the guess is bent at once.
    likely = replace(right, attainable=1.0)
    assert worth([likely, wrong]) == ([likely], [wrong], 0)
    assert worth([right, wrong]) == ([right, wrong], [], 2)
    some, (refused, *_), n = worth([wrong])
    assert (some, n) == ([], 1)
    assert refused.bends
    assert refused.attainable < -9
    # Far behind none, or behind what another map holds, nothing is asked.
    far = replace(right, attainable=-60.0)
    assert worth([far]) == ([], [far], 0)
    assert worth([right, wrong], 60.0) == ([], [right, wrong], 0)


def test_evidence_is_averaged_over_the_covariances_factor(drifting):
    """Weighed at each factor by itself, where residuals are smaller than expected."""
    pair, index = drifting
    models, bending = weigher(index, pair.target)
    truth = models.T_base_model.inv() * pair.T_base_target * models.T_target_model
    noise, drift, errors = bending.null.noise, bending.drifts[0][2], bending._map_errors(truth)

    def evidence(factor, **changed):
        null = Mock(noise=replace(noise, nugget_sd=noise.nugget_sd * np.sqrt(factor), **changed))
        null.log_likelihood.return_value = 0.0
        larger = drift._replace(rate=drift.rate * np.sqrt(factor))
        return replace(bending, null=null, turned_null=null)._fit(truth, larger, factor * errors).log_evidence

    log_factors, log_weights = (x[::8] for x in noise.log_factors())
    at_each = [evidence(np.exp(one), spread=1e-9) for one in log_factors]
    averaged = np.logaddexp.reduce(at_each + log_weights) - np.logaddexp.reduce(log_weights)
    assert evidence(1.0) == pytest.approx(averaged, abs=2.0)


def test_residuals_without_bending_have_the_covariance_of_the_map_and_a_bin(drifting):
    pair, index = drifting
    _, bending = weigher(index, pair.target)
    base, x = index.base, bending.walk.positions[:3]
    bending = replace(bending, walk=replace(bending.walk, positions=x))
    errors = bending._map_errors(RigidTransform.identity())
    unused = np.zeros(3), np.zeros((3, 3, 6))
    turned = bending._rigid_covariance(np.eye(3), errors, np.ones(3, dtype=np.bool_), *unused)
    by_map = base.field_map.posterior.covariance(x)
    noise = bending.null.noise.nugget_sd**2 * np.eye(3)
    blocks = np.stack([turned[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(3)])
    np.testing.assert_allclose(blocks, by_map + noise, rtol=5e-3, atol=1e-3 * np.abs(by_map).max())


def test_nothing_is_weighed_outside_the_base(drifting):
    pair, index = drifting
    models, bending = weigher(index, pair.target)
    far = models.T_base_model.inv() * pair.T_base_target * models.T_target_model
    far = type(far).from_translation([0.0, 0.0, 1e3]) * far
    assert bending.at_each_drift([far]) == []


@pytest.fixture(scope="module")
def walked_again():
    """A corridor passed twice at its true positions, a blind walk through it, and what its stretches say of walks."""
    true, blind = simulate("corridor", 401), simulate("corridor", 401, SimulationConfig(pose_drift=0.1))
    field_map = build_map([true.base, true.target.transformed(true.T_base_target)], SPLINE)
    index = prepare_index(field_map)
    walks, pair = index.walks, WalkStrategy(blind.target, blind.target, CONFIG, 0).pair(index)
    noise = replace(walks.noise, n_stretches=9)  # three, in so short a corridor
    truth = pair.T_base_model.inv() * blind.T_base_target * pair.T_target_model
    rigid = weigh_walk(walks.base, pair.target, [truth], noise, pair.prior)
    return truth, rigid, BendingWalk.of(walks.base, pair.target, noise, pair.prior)


def test_a_walk_may_drift_more_than_the_bases_own_stretches_do(walked_again):
    truth, rigid, bending = walked_again
    found = bending.weigh(rigid)
    assert found[0].bends
    assert found[0].log_evidence > rigid[0].log_evidence + 20
    xi = log_se3(found[0].T_base_target.inv() * truth)
    assert transform_error(found[0].T_base_target, truth, found[0].center)[0] < 0.15
    assert xi @ np.linalg.solve(found[0].covariance, xi) / 6 < 4


def test_by_a_learned_noise_drift_lifts_no_pose_above_what_it_could_attain(walked_again):
    _, rigid, bending = walked_again
    bent = bending.at_each_drift([rigid[0].T_base_target])
    assert max(one.attainable for one in bent) < rigid[0].attainable
    hopeless, likely = replace(rigid[0], attainable=-1.0), replace(rigid[0], attainable=1.0)
    both = bending.base, bending.walk, [likely, hopeless], bending.null.noise, bending.prior
    assert worth_bending(*both, 0.0) == ([likely], [hopeless])
    assert worth_bending(*both, 49.0) == ([likely], [hopeless])
    assert worth_bending(*both, 60.0) == ([], [likely, hopeless])


def test_the_bases_own_stretches_stand_for_all_drifts_up_to_theirs(walked_again):
    _, rigid, bending = walked_again
    rates = [drift.rate for drifts in bending.drifts for drift in drifts]
    assert min(rates) > bending.null.noise.drift_rate
    (own,) = (one for one in bending.weigh(rigid) if not one.bends)
    # All priors together are one; all poses are compared with one null model.
    nulls = [one.log_likelihood(own.is_covered) for one in (bending.null, bending.turned_null)]
    prior = own.log_evidence - rigid[0].log_evidence - nulls[0] + nulls[1]
    assert np.exp(prior) + len(rates) * np.exp(EACH_DRIFT) == pytest.approx(1)


@pytest.mark.parametrize("drift_rate", [1e-3, 0.03, 0.15, 1.0])
def test_what_is_tried_drifts_more_than_the_base_and_the_rest_is_its_own(walked_again, drift_rate):
    _, rigid, bending = walked_again
    noise = replace(bending.null.noise, drift_sd=drift_rate, drift_length=1.0)
    other = BendingWalk.of(bending.base, bending.walk, noise, bending.prior)
    tried = {one.model for one in other.weigh(rigid) if one.bends}
    assert tried == {drift.model for drifts in other.drifts for drift in drifts}
    assert 0 <= other.share <= 0.8
    assert (other.share == 0) == (drift_rate >= 0.4)
