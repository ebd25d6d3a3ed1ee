# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the probabilities: one mass, shared; more evidence is more of it, and nothing excuses evidence against."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from hand_made import WeighedPose, turn_about
from magmatch.estimation.posterior import (
    Fitted,
    answers_of,
    effective_evidence,
    log_odds,
    needed_evidence,
    posterior_of,
)
from magmatch.geometry import random_transform

KINDS = ("map", "walk")
# m and rad
TOLERANCE = (0.5, 0.2)


def weighed(poses, *given):
    """The posterior over poses, given odds and what is elsewhere."""
    return posterior_of(answers_of(poses, TOLERANCE), *given)


evidences, misfits, kinds = st.floats(-300, 3000, allow_subnormal=False), st.floats(0.05, 50), st.sampled_from(KINDS)
prior_odds = st.floats(1e-6, 1e6)
laws = st.builds(
    Fitted,
    scale=st.floats(0.1, 20),
    saturation=st.floats(0.1, 200),
    offset=st.fixed_dictionaries({kind: st.floats(-10, 10) for kind in KINDS}),
)


def shifted(metres, **changes):
    return WeighedPose(RigidTransform.from_translation([metres, 0.0, 0.0]), **changes)


# Far apart from each other, one metre each.
many_apart = st.lists(st.tuples(evidences, misfits, kinds), max_size=6).map(
    lambda rows: [shifted(k, log_evidence=e, misfit=m, kind=kind) for k, (e, m, kind) in enumerate(rows)]
)
elsewheres = st.one_of(st.just(-np.inf), st.floats(-30, 60))


@given(poses=many_apart, odds=prior_odds, elsewhere=elsewheres)
def test_probabilities_of_poses_of_elsewhere_and_of_unrelated_surveys_add_to_one(poses, odds, elsewhere):
    posterior = weighed(poses, odds, elsewhere)
    every = [*posterior.probabilities, posterior.elsewhere, posterior.null]
    assert sum(every) == pytest.approx(1, abs=1e-12)
    assert min(every) >= 0
    assert posterior.best + posterior.rivals + posterior.null == pytest.approx(1, abs=1e-12)
    assert list(posterior.probabilities) == sorted(posterior.probabilities, reverse=True)
    assert posterior.best == max(posterior.probabilities, default=0.0)
    assert len(posterior.poses) == len(poses)


@given(e=st.floats(-60, 60), misfit=misfits, kind=kinds, odds=prior_odds)
def test_prior_odds_act_as_odds(e, misfit, kind, odds):
    """Of one pose alone: what it has over the null scales with them, from what the evidence says by itself."""
    posterior = weighed([WeighedPose(log_evidence=e, misfit=misfit, kind=kind)], odds)
    assert posterior.best / posterior.null == pytest.approx(odds * np.exp(log_odds(e, misfit, kind)), rel=1e-9)
    assert posterior.rivals == 0


@given(poses=many_apart.filter(bool), gain=st.floats(0, 500), relief=st.floats(0.1, 1), elsewhere=elsewheres)
def test_more_agreement_never_lowers_a_poses_probability(poses, gain, relief, elsewhere):
    """Among rivals too: of the first pose before and after its residuals become smaller."""
    one, *others = poses
    better = replace(one, log_evidence=one.log_evidence + gain, misfit=relief * one.misfit)
    before, after = (weighed([pose, *others], 1.0, elsewhere) for pose in (one, better))
    share = dict(zip(map(id, before.poses), before.probabilities, strict=True))[id(one)]
    improved = dict(zip(map(id, after.poses), after.probabilities, strict=True))[id(better)]
    assert improved >= share * (1 - 1e-12)
    assert after.null <= before.null * (1 + 1e-12)


@given(poses=many_apart.filter(bool), elsewhere=elsewheres)
def test_a_further_pose_takes_from_all_and_gives_to_none(poses, elsewhere):
    fewer, more = (weighed(p, 1.0, elsewhere) for p in (poses[:-1], poses))
    share = dict(zip(map(id, more.poses), more.probabilities, strict=True))
    for pose, probability in zip(fewer.poses, fewer.probabilities, strict=True):
        assert share[id(pose)] <= probability * (1 + 1e-12)
    assert more.null <= fewer.null * (1 + 1e-12)


@given(e=st.floats(-1e4, 0), misfit=misfits, kind=kinds, numbers=laws)
def test_evidence_against_a_pose_is_never_excused_by_misfit(e, misfit, kind, numbers):
    assert effective_evidence(e, misfit) == e
    assert log_odds(e, misfit, kind, numbers) == log_odds(e, 1.0, kind, numbers)


@given(p=st.floats(1e-4, 1 - 1e-9), kind=kinds, odds=prior_odds)
def test_needed_evidence_is_that_with_which_a_lone_pose_has_the_probability(p, kind, odds):
    needed = needed_evidence(p, kind, odds)
    posterior = weighed([WeighedPose(log_evidence=needed, kind=kind)], odds)
    assert posterior.best / posterior.null == pytest.approx(p / (1 - p), rel=1e-6)


@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.permutations(range(7)),
    values=st.lists(st.integers(-300, 3000), min_size=7, max_size=7, unique=True),
)
def test_the_order_of_hypotheses_does_not_matter(seed, order, values):
    """Some of one answer, some not; only odds alike to the bit would leave it to the order."""
    at = np.random.default_rng(seed).uniform(-0.5, 0.5, 7)
    poses = [shifted(x, log_evidence=float(e)) for x, e in zip(at, values, strict=True)]
    one, other = (weighed(given_so) for given_so in (poses, [poses[k] for k in order]))
    assert [id(h) for h in one.poses] == [id(h) for h in other.poses]
    assert (one.probabilities, one.null) == (other.probabilities, other.null)


@pytest.mark.parametrize(
    ("xi", "is_one_answer"),
    [
        ([0, 0, 0, 0.499, 0, 0], True),
        ([0, 0, 0, 0.501, 0, 0], False),
        ([0, 0, 0.199, 0, 0, 0], True),
        ([0, 0, 0.201, 0, 0, 0], False),
        ([0, 0.199, 0, 0, 0.499, 0], True),
    ],
)
def test_poses_within_tolerance_are_one_answer_and_the_most_probable_is_kept(xi, is_one_answer):
    """At the target's centre, which may lie far from its frame's origin."""
    T, center = random_transform(np.random.default_rng(0)), np.array([40.0, -20.0, 5.0])
    best = WeighedPose(T, log_evidence=100.0, center=center)
    other = WeighedPose(T * turn_about(center, np.array(xi, float)), log_evidence=90.0, center=center)
    for given_so in ([best, other], [other, best]):
        posterior = weighed(given_so)
        assert posterior.poses[0] is best
        assert len(posterior.poses) == (1 if is_one_answer else 2)
    alone = weighed([best])
    assert (weighed([best, other]).best == alone.best) == is_one_answer


def test_a_pose_near_a_rival_that_is_one_answer_with_the_best_is_a_rival_itself():
    best, near, beyond = shifted(0.0), shifted(0.4, log_evidence=190.0), shifted(0.8, log_evidence=180.0)
    assert weighed([beyond, near, best]).poses == (best, beyond)


@pytest.mark.parametrize("kind", KINDS)
def test_chance_is_improbable_and_clear_evidence_is_not(kind):
    """The ends of the scale, whatever is fitted between them."""

    def probability(e, misfit=1.0):
        return weighed([WeighedPose(log_evidence=e, misfit=misfit, kind=kind)]).best

    assert probability(-20.0) < 0.01
    assert probability(0.0) < 0.9
    assert probability(15.0, misfit=30.0) < 0.99
    assert probability(60.0) > 0.99
    assert probability(150.0, misfit=0.6) > 0.9999


@given(e=st.floats(0, 300), gap=st.floats(-60, 60), misfit=st.floats(0.5, 3))
def test_models_of_one_pose_add_up_and_poses_of_one_model_do_not(e, gap, misfit):
    rigid = shifted(0.0, log_evidence=e, misfit=misfit)
    freer, again = (shifted(0.1, log_evidence=e + gap, model=model) for model in ("bends", "rigid"))
    (both,) = weighed([rigid, freer]).answers
    effective = [effective_evidence(h.log_evidence, h.misfit) for h in (rigid, freer)]
    assert both.effective == pytest.approx(np.logaddexp(*effective), abs=1e-9)
    assert both.best is (rigid if effective[0] >= effective[1] else freer)
    assert sum(both.shares) == pytest.approx(1)
    assert both.shares[0] == pytest.approx(np.exp(max(effective) - both.effective))
    (one,) = weighed([rigid, again]).answers
    assert one.effective == max(effective)


def test_models_of_a_pose_are_one_answer_where_it_is_known_less_well_than_is_asked():
    rough = np.diag([0.01] * 3 + [0.5**2] * 3)
    best = shifted(0.0, covariance=rough)
    freer, rival = (shifted(1.4, log_evidence=190.0, model=model) for model in ("bends", "rigid"))
    assert len(weighed([best, freer]).answers) == 1
    assert len(weighed([best, rival]).answers) == 2
