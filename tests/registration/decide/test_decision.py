# SPDX-License-Identifier: BSD-3-Clause
"""Which check refuses what: both sides of each limit, of poses that are otherwise beyond doubt."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.registration.decide.decision import DecisionConfig, decide, odds_in_words
from magmatch.registration.refine.refinement import RefinedPose
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors
from magmatch.registration.result import Status
from magmatch.registration.weigh.evidence import PoseEvidence

CONFIG = DecisionConfig()
SENSOR = identical_sensors(SensorConfig(mode="none"), -1)
POSE = RefinedPose(RigidTransform.identity(), np.zeros(3), SENSOR, np.ones(3), np.zeros((6, 6)), ())
CLEAR = PoseEvidence(
    POSE, np.eye(6), overlap=0.9, n_informative=40, n_good=38, log_evidence=200.0, unexplained=1e-3,
    residual=1.0, misfit=0.6,
)  # fmt: skip
REFUSED = Status.INCONSISTENT


def status_of(best=CLEAR, lead=np.inf, decoys=None, is_free=False, config=CONFIG, **changes):
    return decide([replace(best, **changes)], is_free, lead, decoys, config).status


def test_a_clear_pose_is_accepted():
    assert status_of() is Status.ACCEPTED


@pytest.mark.parametrize(
    ("just", "beyond", "status"),
    [
        ({"overlap": 0.05}, {"overlap": 0.0499}, Status.NO_OVERLAP),
        ({"n_informative": 6, "n_good": 6}, {"n_informative": 5, "n_good": 5}, Status.UNINFORMATIVE),
        ({"n_informative": 10, "n_good": 7}, {"n_informative": 100, "n_good": 69}, REFUSED),
        ({"n_informative": 8, "n_good": 6}, {"n_informative": 7, "n_good": 5}, REFUSED),
        ({"residual": 3.0}, {"residual": 3.001}, REFUSED),
        ({"log_evidence": 15.0}, {"log_evidence": 14.99}, REFUSED),
        ({"log_evidence": 149.0, "misfit": 3.0}, {"log_evidence": 149.0, "misfit": 3.001}, REFUSED),
        ({"log_evidence": 150.0, "misfit": 9.0}, {"log_evidence": 149.9, "misfit": 9.0}, REFUSED),
        ({"log_evidence": 16.0, "lead": 10.0}, {"log_evidence": 16.0, "lead": 9.99}, Status.AMBIGUOUS),
        ({"lead": 100.0}, {"lead": 99.9}, Status.AMBIGUOUS),
        ({"log_evidence": 40.0, "decoys": 25.0}, {"log_evidence": 40.0, "decoys": 25.01}, REFUSED),
        ({"log_evidence": 40.0, "decoys": -99.0}, {"log_evidence": 14.0, "decoys": -99.0}, REFUSED),
    ],
)
def test_each_limit_refuses_on_its_own_side_alone(just, beyond, status):
    assert status_of(**just) is Status.ACCEPTED
    assert status_of(**beyond) is status


def test_residuals_that_nothing_explains_ask_for_more_than_chance_reaches():
    # A factor e costs twenty nats; residuals as expected or smaller cost nothing.
    just = {"misfit": np.e, "decoys": 65.0}
    assert status_of(log_evidence=100.0, **just) is Status.ACCEPTED
    assert status_of(log_evidence=99.9, **just) is REFUSED
    assert status_of(log_evidence=80.0, misfit=0.2, decoys=65.0) is Status.ACCEPTED


def test_a_free_direction_is_degenerate_and_then_odds_need_not_be_large():
    assert status_of(is_free=True) is Status.DEGENERATE
    assert status_of(is_free=True, log_evidence=1.0) is Status.DEGENERATE
    assert status_of(is_free=True, residual=5.0) is REFUSED
    assert status_of(is_free=True, lead=1.0) is Status.AMBIGUOUS


def test_what_is_wrong_first_is_said_first():
    assert status_of(overlap=0.0, n_informative=0, residual=9.0) is Status.NO_OVERLAP
    assert status_of(n_informative=0, n_good=0, residual=9.0) is Status.UNINFORMATIVE
    assert status_of(residual=9.0, lead=0.0, is_free=True) is REFUSED


def test_no_pose_at_all_is_a_result():
    assert decide([], False, np.inf, None, CONFIG).status is Status.UNINFORMATIVE


def test_the_best_pose_is_judged_and_not_its_rivals():
    assert decide([CLEAR, replace(CLEAR, overlap=0.0)], False, np.inf, None, CONFIG).status is Status.ACCEPTED
    assert decide([replace(CLEAR, overlap=0.0), CLEAR], False, np.inf, None, CONFIG).status is Status.NO_OVERLAP


def test_reason_names_the_number_that_decided():
    verdict = decide([replace(CLEAR, overlap=0.01)], False, np.inf, None, CONFIG)
    assert "1%" in verdict.reason
    assert "5%" in verdict.reason
    assert "38 of 40" in decide([CLEAR], False, 123.0, None, CONFIG).reason
    assert odds_in_words(50.0, 20.0) == "log odds 50 nats, 20 nats ahead of any other pose"
    assert odds_in_words(50.0, None) == odds_in_words(50.0, np.inf) == "log odds 50 nats, no rival pose"
