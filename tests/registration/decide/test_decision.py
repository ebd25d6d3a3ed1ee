# SPDX-License-Identifier: BSD-3-Clause
"""Accepted is a pose that is probable and known well enough; else the status says where the rest of the mass is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform

from hand_made import WeighedPose
from magmatch.estimation.posterior import Answer, Posterior, needed_evidence, posterior_over
from magmatch.registration.decide.decision import NO_POSE, DecisionConfig, decide, in_words
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.result import Status

CONFIG = DecisionConfig()
# m
LENGTH = 0.6
NEEDED = needed_evidence(CONFIG.min_probability, "map")


def posterior_of(best=0.995, rivals=0.0, elsewhere=0.0, pose=None):
    """The best pose, two others and another map, each with its probability; the rest is the null's."""
    poses = (pose or WeighedPose(), WeighedPose(log_evidence=20.0), WeighedPose(log_evidence=10.0))
    answers = tuple(Answer.of([pose]) for pose in poses)
    return Posterior(answers, (best, 0.75 * rivals, 0.25 * rivals), elsewhere, 1 - best - rivals - elsewhere)


def estimate_of(turn=0.01, shift=0.01):
    return Estimate(RigidTransform.identity(), np.zeros(3), np.diag([turn**2] * 3 + [shift**2] * 3))


def verdict_of(best=0.995, rivals=0.0, elsewhere=0.0, pose=None, estimate=None, config=CONFIG, **changes):
    pose = replace(pose or WeighedPose(), **changes)
    return decide(posterior_of(best, rivals, elsewhere, pose), estimate or estimate_of(), LENGTH, config)


def status_of(**said):
    return verdict_of(**said).status


@pytest.mark.parametrize("limit", [0.5, 0.9, 0.99, 0.999])
def test_a_pose_is_accepted_from_the_least_probability_on(limit):
    config = DecisionConfig(min_probability=limit)
    assert status_of(best=limit, config=config) is Status.ACCEPTED
    assert status_of(best=limit - 1e-6, config=config) is not Status.ACCEPTED


@pytest.mark.parametrize(
    ("just", "beyond", "status"),
    [
        # Of the mass that the best pose lacks, other poses have at least as much as the null.
        ({"best": 0.6, "rivals": 0.199}, {"best": 0.6, "rivals": 0.201}, Status.AMBIGUOUS),
        ({"best": 0.6, "elsewhere": 0.199}, {"best": 0.6, "elsewhere": 0.201}, Status.AMBIGUOUS),
        (
            {"best": 0.6, "rivals": 0.1, "elsewhere": 0.099},
            {"best": 0.6, "rivals": 0.1, "elsewhere": 0.101},
            Status.AMBIGUOUS,
        ),
        # All of the target would have to overlap for a perfect match to show.
        (
            {"best": 0.6, "overlap": 0.5, "attainable": 0.499 * NEEDED},
            {"best": 0.6, "overlap": 0.5, "attainable": 0.501 * NEEDED},
            Status.NO_OVERLAP,
        ),
        (
            {"best": 0.6, "overlap": 0.801, "attainable": 0.8 * NEEDED},
            {"best": 0.6, "overlap": 0.799, "attainable": 0.8 * NEEDED},
            Status.NO_OVERLAP,
        ),
        # The field could not show a match.
        (
            {"best": 0.6, "overlap": 1.0, "attainable": 1.001 * NEEDED},
            {"best": 0.6, "overlap": 1.0, "attainable": 0.999 * NEEDED},
            Status.UNINFORMATIVE,
        ),
        # It could, and does not.
        (
            {"best": 0.6, "overlap": 0.01, "attainable": 0.009 * NEEDED},
            {"best": 0.6, "overlap": 0.01, "attainable": 1.001 * NEEDED},
            Status.INCONSISTENT,
        ),
    ],
)
def test_a_refusal_says_where_the_rest_of_the_probability_lies(just, beyond, status):
    assert status_of(**just) not in (status, Status.ACCEPTED)
    assert status_of(**beyond) is status


def test_rivals_are_named_before_what_the_null_would_say():
    assert status_of(best=0.4, rivals=0.5, attainable=0.0, overlap=0.01) is Status.AMBIGUOUS
    assert status_of(best=0.6, attainable=-5.0, overlap=0.5) is Status.UNINFORMATIVE
    assert status_of(best=0.6, attainable=-5.0, overlap=0.0) is Status.UNINFORMATIVE


@pytest.mark.parametrize("kind", ["map", "walk"])
def test_what_a_perfect_match_must_reach_depends_on_kind_probability_and_prior_odds(kind):
    for config in (CONFIG, DecisionConfig(min_probability=0.9), DecisionConfig(prior_odds=1e-3)):
        needed = needed_evidence(config.min_probability, kind, config.prior_odds)
        assert status_of(best=0.3, kind=kind, attainable=needed * 1.001, config=config) is Status.INCONSISTENT
        assert status_of(best=0.3, kind=kind, attainable=needed * 0.999, overlap=1.0, config=config) is (
            Status.UNINFORMATIVE
        )


@pytest.mark.parametrize(
    ("just", "beyond"),
    [
        (estimate_of(shift=0.1799), estimate_of(shift=0.1801)),  # 0.3 lengths of 0.6 m
        (estimate_of(turn=0.0799), estimate_of(turn=0.0801)),
    ],
)
def test_a_probable_pose_that_is_not_known_well_enough_is_degenerate(just, beyond):
    assert status_of(estimate=just) is Status.ACCEPTED
    verdict = verdict_of(estimate=beyond)
    assert verdict.status is Status.DEGENERATE
    assert all(d.words in verdict.reason for d in beyond.free_directions(CONFIG.max_sd(LENGTH)))
    assert status_of(best=0.5, rivals=0.4, estimate=beyond) is Status.AMBIGUOUS
    assert status_of(best=0.5, estimate=beyond) is Status.INCONSISTENT


def test_a_pose_that_nothing_fixes_is_degenerate():
    verdict = verdict_of(estimate=replace(estimate_of(), covariance=None))
    assert verdict.status is Status.DEGENERATE
    assert "in no direction" in verdict.reason


def test_a_largest_spread_in_metres_overrides_the_one_in_lengths():
    assert CONFIG.max_sd(LENGTH) == pytest.approx((0.3 * LENGTH, 0.08))
    stated = DecisionConfig(max_sd_translation=0.05, max_sd_translation_in_lengths=9.0, max_sd_rotation=0.02)
    for length in (0.1, LENGTH, 40.0):
        assert stated.max_sd(length) == (0.05, 0.02)
        # Right is within three of them.
        assert stated.tolerance(length) == pytest.approx((0.15, 0.06))
    assert status_of(estimate=estimate_of(shift=0.049), config=stated) is Status.ACCEPTED
    assert status_of(estimate=estimate_of(shift=0.051), config=stated) is Status.DEGENERATE
    wide = DecisionConfig(max_sd_translation=5.0)
    assert status_of(estimate=estimate_of(shift=4.9), config=wide) is Status.ACCEPTED


@given(length=st.floats(0.01, 100), share=st.floats(0.01, 10), turn=st.floats(0.001, 3))
def test_an_accepted_pose_is_right_within_what_makes_two_poses_one_answer(length, share, turn):
    config = DecisionConfig(max_sd_translation_in_lengths=share, max_sd_rotation=turn)
    assert config.tolerance(length) == pytest.approx(tuple(3 * sd for sd in config.max_sd(length)))
    assert config.max_sd(length) == pytest.approx((share * length, turn))


@pytest.mark.parametrize(
    "bad",
    [
        {"min_probability": 0.0},
        {"min_probability": 1.0},
        {"max_sd_translation": 0.0},
        {"max_sd_translation_in_lengths": 0.0},
        {"max_sd_rotation": -0.1},
        {"prior_odds": 0.0},
        {"min_log_odds": 15.0},
    ],
)
def test_limits_that_cannot_be_are_refused(bad):
    with pytest.raises(ValidationError):
        DecisionConfig.model_validate(bad)


def test_no_pose_at_all_is_a_result_with_a_remedy():
    assert NO_POSE.status is Status.UNINFORMATIVE
    assert "survey closer to iron" in NO_POSE.reason


def test_reasons_name_the_numbers_that_decided():
    assert "0.995" in verdict_of().reason
    assert "200 nats of evidence" in verdict_of().reason
    assert "8 nats ahead of any other pose" in verdict_of(best=0.995, rivals=0.0003).reason
    alone = decide(posterior_over([WeighedPose()], (1.0, 1.0)), estimate_of(), LENGTH, CONFIG)
    assert "200 nats" in alone.reason
    assert "other pose" not in alone.reason
    ambiguous = verdict_of(best=0.41, rivals=0.3, elsewhere=0.25).reason
    assert "0.41" in ambiguous
    assert "0.55 together" in ambiguous
    assert "12% of the target" in verdict_of(best=0.2, attainable=0.5 * NEEDED, overlap=0.123).reason
    faint = verdict_of(best=0.2, attainable=3.2, overlap=1.0).reason
    assert f"would reach 3 nats, {np.ceil(NEEDED):.0f} are needed" in faint
    assert "would reach 0 nats" in verdict_of(best=0.2, attainable=-7.0, overlap=1.0).reason


def test_a_reason_says_how_likely_different_places_are():
    assert verdict_of(best=0.2).reason.startswith("probably different places")
    assert verdict_of(best=0.6).reason.startswith("perhaps different places")
    strained = verdict_of(best=0.2, log_evidence=90.0, misfit=9.0)
    assert strained.status is Status.INCONSISTENT
    assert "90 nats" not in strained.reason  # they count for less
    assert f"{np.ceil(NEEDED):.0f} are needed" in strained.reason


def test_what_does_not_suffice_does_not_read_as_if_it_did():
    reason = verdict_of(best=0.9899, log_evidence=NEEDED - 0.1, attainable=2 * NEEDED).reason
    assert "probability 0.989 (" in reason
    assert f"({np.floor(NEEDED - 0.1):.0f} nats of evidence, {np.ceil(NEEDED):.0f} are needed)" in reason


masses = st.lists(st.floats(0.001, 1), min_size=4, max_size=4).map(lambda m: [v / sum(m) for v in m])


@given(
    masses=masses,
    log_evidence=st.floats(-100, 1000),
    attainable=st.floats(-100, 1000),
    misfit=st.floats(0.1, 20),
    overlap=st.floats(0, 1),
    kind=st.sampled_from(["map", "walk"]),
    turn=st.floats(1e-4, 3),
    shift=st.floats(1e-4, 30),
    min_probability=st.floats(0.01, 0.999),
)
def test_whatever_is_found_the_verdict_follows_and_its_reason_has_three_sentences_at_most(
    masses, log_evidence, attainable, misfit, overlap, kind, turn, shift, min_probability
):
    best, rivals, elsewhere, _ = masses
    config, estimate = DecisionConfig(min_probability=min_probability), estimate_of(turn, shift)
    said = {
        "log_evidence": log_evidence,
        "attainable": attainable,
        "misfit": misfit,
        "overlap": overlap,
        "kind": kind,
    }
    verdict = verdict_of(best, rivals, elsewhere, estimate=estimate, config=config, **said)
    is_probable, is_known = best >= min_probability, not estimate.free_directions(config.max_sd(LENGTH))
    assert (verdict.status is Status.ACCEPTED) == (is_probable and is_known)
    assert (verdict.status is Status.DEGENERATE) == (is_probable and not is_known)
    sentences = [s for s in re.split(r"[.;!?](?:\s|$)", verdict.reason) if s]
    assert 1 <= len(sentences) <= 3
    assert "nan" not in verdict.reason


@given(st.floats(0.5, 1.0))
def test_a_probability_in_words_is_never_certainty_and_keeps_its_first_digit_that_is_no_nine(p):
    words = in_words(p)
    if p > 1 - 1e-6:
        assert words == "above 0.999999"
    else:
        assert float(words) < 1
        assert abs(float(words) - p) <= 0.5 * (1 - p) + 0.0051


@pytest.mark.parametrize(
    ("p", "words"), [(0.99, "0.99"), (0.9942, "0.994"), (0.99975, "0.9998"), (0.5, "0.50"), (1.0, "above 0.999999")]
)
def test_probabilities_in_words(p, words):
    assert in_words(p) == words


def test_the_lead_over_any_other_pose_is_over_any_other_pose():
    """A rival whose residuals nothing explains may have more evidence, and not be second."""
    far = RigidTransform.from_translation([50.0, 0.0, 0.0])
    farther = RigidTransform.from_translation([0.0, 50.0, 0.0])
    rivals = [WeighedPose(far, log_evidence=60.0), WeighedPose(farther, log_evidence=190.0, misfit=5.0)]
    posterior = posterior_over([WeighedPose(), *rivals], (1.0, 1.0))
    reason = decide(posterior, estimate_of(), LENGTH, CONFIG).reason
    assert "140 nats ahead" not in reason


def test_a_pose_within_both_limits_is_accepted_however_turn_and_shift_go_together():
    C = estimate_of(turn=0.07, shift=0.16).covariance
    C[0, 3] = C[3, 0] = 0.95 * 0.07 * 0.16
    estimate = replace(estimate_of(), covariance=C)
    assert estimate.worst_sd == pytest.approx((0.16, 0.07))
    assert status_of(estimate=estimate) is Status.ACCEPTED
