"""Which check refuses what."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.registration.both_sides import needs_both_sides
from magmatch.registration.decide.decision import DecisionConfig, decide
from magmatch.registration.decide.walk_answer import WalkDecisionConfig, _refusals
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.weigh.covariance import to_survey_axes

CONFIG = DecisionConfig()


def evidence(**changes):
    good = {
        "overlap": 0.9,
        "n_informative": 40,
        "n_good": 38,
        "good_share": 0.95,
        "log_evidence": 200.0,
        "residual": 1.0,
        "misfit": 0.6,
    }
    return SimpleNamespace(**(good | changes))


@pytest.mark.parametrize(
    ("changes", "is_free", "lead", "status"),
    [
        ({}, False, np.inf, Status.ACCEPTED),
        ({}, False, 100.0, Status.ACCEPTED),
        ({"overlap": 0.01}, False, np.inf, Status.NO_OVERLAP),
        ({"n_informative": 2}, False, np.inf, Status.UNINFORMATIVE),
        ({"n_good": 10, "good_share": 0.25}, False, np.inf, Status.INCONSISTENT),
        ({"log_evidence": 5.0}, False, np.inf, Status.INCONSISTENT),
        ({"residual": 5.0}, False, np.inf, Status.INCONSISTENT),
        ({}, False, 1.0, Status.AMBIGUOUS),
        ({}, True, np.inf, Status.DEGENERATE),
    ],
)
def test_each_check_gives_its_own_status(changes, is_free, lead, status):
    assert decide([evidence(**changes)], is_free, lead, None, CONFIG).status is status


def test_odds_that_mirror_images_reach_are_chance_and_more_is_asked_of_a_pose_that_leaves_residuals():
    assert decide([evidence(log_evidence=40.0)], False, np.inf, 20.0, CONFIG).status is Status.ACCEPTED
    assert decide([evidence(log_evidence=40.0)], False, np.inf, 30.0, CONFIG).status is Status.INCONSISTENT
    left = evidence(log_evidence=40.0, misfit=3.0)
    assert decide([left], False, np.inf, 20.0, CONFIG).status is Status.INCONSISTENT


def test_cells_that_differ_by_more_than_noise_are_accepted_only_beyond_all_chance():
    assert (
        decide([evidence(log_evidence=80.0, misfit=4.0)], False, np.inf, None, CONFIG).status is Status.INCONSISTENT
    )
    assert decide([evidence(log_evidence=200.0, misfit=4.0)], False, np.inf, None, CONFIG).status is Status.ACCEPTED


def test_poses_that_explain_the_field_equally_well_are_ambiguous_however_much_there_is_to_explain():
    assert decide([evidence(log_evidence=400.0)], False, 30.0, None, CONFIG).status is Status.AMBIGUOUS
    assert decide([evidence(log_evidence=400.0)], False, 200.0, None, CONFIG).status is Status.ACCEPTED


def test_uncertainty_is_said_where_the_target_lies_not_at_a_far_origin():
    # 1 mrad about a centre 100 m from the origin, known to 5 mm there: the origin itself is unsure by 0.1 m.
    center, turn, shift = np.array([100.0, 0.0, 0.0]), 1e-3, 5e-3
    about_center = np.diag([turn**2] * 3 + [shift**2] * 3)
    C = to_survey_axes(about_center, center, RigidTransform.identity())
    result = RegistrationResult(Status.ACCEPTED, "", RigidTransform.identity(), covariance=C)
    np.testing.assert_allclose(result.standard_deviations, [np.sqrt(3) * turn, np.sqrt(3) * shift], rtol=1e-6)
    assert np.sqrt(np.trace(C[3:, 3:])) > 0.1


def test_no_pose_at_all_is_a_result():
    assert decide([], False, np.inf, None, CONFIG).status is Status.UNINFORMATIVE


def test_reason_names_the_number_that_decided():
    verdict = decide([evidence(overlap=0.01)], False, np.inf, None, CONFIG)
    assert "1%" in verdict.reason
    assert "5%" in verdict.reason


@pytest.mark.parametrize(
    ("coverage", "log_evidence", "status"),
    [(0.65, 20.0, None), (0.5, 20.0, Status.NO_OVERLAP), (0.5, 90.0, None), (0.25, 90.0, Status.NO_OVERLAP)],
)
def test_less_of_a_walk_inside_the_map_will_do_where_what_there_is_leaves_no_doubt(coverage, log_evidence, status):
    best = SimpleNamespace(coverage=coverage, log_evidence=log_evidence, residual=1.0)
    verdict = next(_refusals(best, (), np.inf, WalkDecisionConfig()), None)
    assert (verdict and verdict.status) == status


@pytest.mark.parametrize(
    ("status", "n_stretches", "is_needed"),
    [
        (Status.ACCEPTED, 0, True),
        (Status.DEGENERATE, 0, True),
        (Status.AMBIGUOUS, 0, False),
        (Status.ACCEPTED, 40, False),
    ],
)
def test_a_walk_that_was_found_is_refined_from_both_sides_where_the_base_taught_nothing(
    status, n_stretches, is_needed
):
    walks = SimpleNamespace(noise=PathNoise(*np.ones(9), n_stretches=n_stretches))
    assert needs_both_sides(walks, RegistrationResult(status, "as it may be", None)) == is_needed
