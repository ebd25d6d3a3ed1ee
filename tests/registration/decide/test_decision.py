# SPDX-License-Identifier: BSD-3-Clause
"""Accepted is a pose that is probable and known well enough; else the status says where the rest of the mass is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from hand_made import WeighedPose
from magmatch.estimation.posterior import Answer, Posterior, needed_evidence
from magmatch.registration.decide.decision import DecisionConfig, decide, in_words, is_sharp
from magmatch.registration.decide.estimate import Estimate
from magmatch.registration.result import Status

CONFIG = DecisionConfig()
# m
LENGTH = 0.6
NEEDED = needed_evidence(CONFIG.min_probability, "map")


def posterior_of(best=0.995, rivals=0.0, elsewhere=0.0, pose=None):
    """The best pose, two others and another map, each with its probability; the rest is the null's."""
    first = pose or WeighedPose()
    others = (WeighedPose(log_evidence=e, attainable=first.attainable) for e in (20.0, 10.0))
    poses = (first, *others)
    answers = tuple(Answer.of([pose]) for pose in poses)
    return Posterior(answers, (best, 0.75 * rivals, 0.25 * rivals), elsewhere, 1 - best - rivals - elsewhere)


def estimate_of(turn=0.01, shift=0.01):
    return Estimate(RigidTransform.identity(), np.zeros(3), np.diag([turn**2] * 3 + [shift**2] * 3))


def verdict_of(best=0.995, rivals=0.0, elsewhere=0.0, pose=None, estimate=None, config=CONFIG, **changes):
    pose = replace(pose or WeighedPose(), **changes)
    return decide(posterior_of(best, rivals, elsewhere, pose), estimate or estimate_of(), LENGTH, config)


def status_of(**said):
    return verdict_of(**said).status


def test_a_pose_is_accepted_from_the_least_probability_on():
    limit, config = 0.9, DecisionConfig(min_probability=0.9)
    assert status_of(best=limit, config=config) is Status.ACCEPTED
    assert status_of(best=limit - 1e-6, config=config) is not Status.ACCEPTED


@pytest.mark.parametrize(
    ("status", "what", "just", "beyond", "others"),
    [
        # Of the mass that the best pose lacks, other poses have at least as much as the null.
        (Status.AMBIGUOUS, "rivals", 0.199, 0.201, {}),
        (Status.AMBIGUOUS, "elsewhere", 0.199, 0.201, {}),
        # All of the target would have to overlap for a perfect match to show.
        (Status.NO_OVERLAP, "attainable", 0.499 * NEEDED, 0.501 * NEEDED, {"overlap": 0.5}),
        (Status.NO_OVERLAP, "overlap", 0.801, 0.799, {"attainable": 0.8 * NEEDED}),
        # The field could not show a match.
        (Status.UNINFORMATIVE, "attainable", 1.001 * NEEDED, 0.999 * NEEDED, {"overlap": 1.0}),
        # It could, and does not.
        (Status.INCONSISTENT, "attainable", 0.009 * NEEDED, 1.001 * NEEDED, {"overlap": 0.01}),
    ],
)
def test_a_refusal_says_where_the_rest_of_the_probability_lies(status, what, just, beyond, others):
    assert status_of(best=0.6, **{what: just}, **others) not in (status, Status.ACCEPTED)
    assert status_of(best=0.6, **{what: beyond}, **others) is status


def test_a_field_in_which_another_pose_could_match_is_not_blamed():
    """The best pose barely lies in the base, as a wrong one may; another could have shown a match, and does not."""
    poses = (WeighedPose(attainable=0.0, overlap=1.0), WeighedPose(log_evidence=20.0, attainable=300.0))
    posterior = Posterior(tuple(Answer.of([pose]) for pose in poses), (0.6, 0.0), 0.0, 0.4)
    assert decide(posterior, estimate_of(), LENGTH, CONFIG).status is Status.INCONSISTENT


def test_a_pose_is_sharp_whose_heading_is_known_as_well_as_answers_are_told_apart():
    for turn, expected in ((0.0799, True), (0.0801, False)):
        assert is_sharp(estimate_of(shift=9.0, turn=turn).covariance) is expected
    assert not is_sharp(None)


@pytest.mark.parametrize(
    ("just", "beyond"),
    [
        (estimate_of(shift=0.1799), estimate_of(shift=0.1801)),  # 0.3 lengths of 0.6 m
        (estimate_of(turn=0.1744), estimate_of(turn=0.1746)),  # 10 degrees
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
    pose = WeighedPose(log_evidence=log_evidence, attainable=attainable, misfit=misfit, overlap=overlap, kind=kind)
    verdict = verdict_of(best, rivals, elsewhere, pose, estimate, config)
    is_probable, is_known = best >= min_probability, not estimate.free_directions(config.max_sd(LENGTH))
    assert (verdict.status is Status.ACCEPTED) == (is_probable and is_known)
    assert (verdict.status is Status.DEGENERATE) == (is_probable and not is_known)
    sentences = [s for s in re.split(r"[.;!?](?:\s|$)", verdict.reason) if s]
    assert 1 <= len(sentences) <= 3
    assert "nan" not in verdict.reason


@pytest.mark.parametrize(
    ("p", "words"), [(0.99, "0.99"), (0.9942, "0.994"), (0.99975, "0.9998"), (0.5, "0.50"), (1.0, "above 0.999999")]
)
def test_probabilities_in_words(p, words):
    assert in_words(p) == words
