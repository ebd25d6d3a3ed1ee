"""Surveys that state how far their positions drift get answers that reckon with it."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from hand_made import Polynomial, box, prepared_map, some_field
from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePrior
from magmatch.registration.prepared.drift import Drift, white_variance
from magmatch.registration.refine.refinement import refine
from magmatch.registration.weigh.covariance import drift_covariance

# 10 uT times (x^2 - y^2, -2 x y, 0): its gradient grows with the distance from the middle.
BEND = np.zeros((3, 3, 3))
BEND[0, 0, 0], BEND[0, 1, 1], BEND[1, 0, 1], BEND[1, 1, 0] = 2, -2, -2, -2
QUADRATIC = Polynomial(np.zeros(3), second=1e-5 * BEND)


def drift_along(positions, pose_sd):
    return drift_of(positions, QUADRATIC.evaluate(positions).field, pose_sd, QUADRATIC)


def drift_of(positions, field, pose_sd, posterior):
    return Drift.of(Survey(positions, field, pose_sd=pose_sd), posterior)


def circles(n=400):
    """Three rounds that widen."""
    angle = np.linspace(0, 6 * np.pi, n)
    return np.c_[(1 + 0.1 * angle) * np.cos(angle), (1 + 0.1 * angle) * np.sin(angle), 0.1 * angle]


def test_scores_scatter_as_much_as_drifts_move_them_that_forget_themselves_in_a_tenth_of_the_path():
    """Against the covariance of all samples; stretches are an eighth of the correlation length."""
    rng = np.random.default_rng(1)
    x = circles()
    drift = drift_along(x, 0.05)
    rows = np.sort(rng.permutation(len(x))[:300])
    weighted, G = 1.0 + rng.normal(size=(300, 3, 7)), np.eye(3) + rng.normal(size=(300, 3, 3))
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    K = 0.05**2 * np.exp(-np.abs(walked[rows, None] - walked[rows]) / (walked[-1] / 10))
    push = np.einsum("nip,nij->njp", weighted, G)
    expected = np.einsum("njp,nm,mjq->pq", push, K, push, optimize=True)
    found = drift.score_covariance(weighted, G, rows)
    np.testing.assert_allclose(found, expected, atol=0.04 * np.diag(found).max())
    np.testing.assert_allclose(found, found.T, rtol=1e-12)


@pytest.mark.parametrize("pose_sd", [0.0, 0.05])
def test_samples_that_follow_no_path_share_no_error(pose_sd):
    x = np.random.default_rng(2).permutation(circles())
    drift = drift_along(x, pose_sd)
    assert drift.sd == pose_sd
    assert not drift.score_covariance(np.ones((9, 3, 6)), np.ones((9, 3, 3)), np.arange(9)).any()


@pytest.mark.parametrize("noise_sd", [0.0, 2e-7, 1e-6])
def test_errors_of_each_sample_are_told_from_those_that_last(noise_sd):
    rng = np.random.default_rng(5)
    x = circles(3000)
    own = 0.03 * rng.normal(size=x.shape)
    slow = 0.1 * np.sin(np.linspace(0, 12, len(x)))[:, None] * np.ones(3)
    noise = noise_sd * rng.normal(size=x.shape)
    field = QUADRATIC
    jumpy = field.evaluate(x + own).field + noise
    assert np.sqrt(white_variance(x, jumpy, field)) == pytest.approx(0.03, rel=0.1)
    smooth = field.evaluate(x + slow).field + noise
    assert white_variance(x, smooth, field) < 0.01**2
    both = field.evaluate(x + own + slow).field + noise
    assert drift_of(x, both, 0.1, field).lasting_sd == pytest.approx(np.sqrt(0.1**2 - 0.03**2), rel=0.05)
    assert drift_of(x, jumpy, 0.03, field).lasting_sd < 0.01


def test_a_survey_that_is_off_as_a_whole_takes_the_pose_along_as_far():
    """Unlike drifts of base and target, each alike all along its path: their variances add up, and turns stay."""
    rng, n = np.random.default_rng(4), 120
    field = some_field(3, slope=10e-6)
    whole = [Drift(0.0, sd, np.zeros(n, dtype=np.int64), np.ones((1, 1))) for sd in (0.03, 0.1)]
    base, target = (prepared_map(field, box(rng, n), rng, spacing=0.05, drift=drift) for drift in whole)
    pose = refine(base, target, RigidTransform.identity(), PosePrior(10.0), "auto", rng)
    expected = np.diag([0.0] * 3 + [0.03**2 + 0.1**2] * 3)
    np.testing.assert_allclose(drift_covariance(pose), expected, atol=1e-6)
