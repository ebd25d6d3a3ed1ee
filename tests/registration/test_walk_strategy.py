# SPDX-License-Identifier: BSD-3-Clause
"""What a walk's pose is stated with: the whole of its frame may be off, whatever its residuals show."""

from dataclasses import replace

import numpy as np

from hand_made import prepared_map, some_field
from magmatch.estimation.path_noise import PathNoise
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.walk import Walk
from magmatch.geometry import random_transform
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.decision import DecisionConfig, Verdict
from magmatch.registration.decide.estimate import Pair
from magmatch.registration.index.map_index import WalkIndex
from magmatch.registration.result import Status
from magmatch.registration.steps import _naming_drift
from magmatch.registration.walk_strategy import WalkStrategy
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence

RNG = np.random.default_rng(0)
T_BASE, T_WALK, T_POSE = (random_transform(RNG) for _ in range(3))
POSITIONS = RNG.normal(size=(20, 3))
WALK = Walk(T_WALK, POSITIONS, np.ones((20, 3)), pose_sd=0.02)
LEARNED = PathNoise(0.4e-6, 0.8, 0.2e-6, 0.2e-6, 1.0, 0.8, 0.005, 0.01, 3.0, spread=0.4, n_stretches=9)
SD = np.array([0.01, 0.012, 0.008, 0.05, 0.04, 0.06])
BEST = LineEvidence(
    T_POSE, POSITIONS.mean(axis=0), np.diag(SD**2), overlap=0.75, log_evidence=60.0, attainable=80.0, misfit=1.3,
    is_covered=np.arange(20) < 15,
)  # fmt: skip
STRATEGY = WalkStrategy(None, None, RegistrationConfig(), 0)
PAIR = Pair(
    WalkIndex(prepared_map(some_field(1), POSITIONS, length=2.0), LEARNED, LEARNED, None),
    WALK,
    PosePrior(1.0),
    2.0,
    T_BASE,
    T_WALK,
)


def test_a_walks_pose_is_said_between_the_surveys_frames_and_is_as_unsure_as_its_frame():
    estimate, support = STRATEGY.state(PAIR, BEST)
    T = T_BASE * T_POSE * T_WALK.inv()
    np.testing.assert_allclose(estimate.T_base_target.as_matrix(), T.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(estimate.center, T_WALK.apply(BEST.center), atol=1e-12)
    whole = np.diag(SD**2 + [0, 0, 0, 0.02**2, 0.02**2, 0.02**2])
    R = np.kron(np.eye(2), T_WALK.rotation.as_matrix())
    np.testing.assert_allclose(estimate.covariance, R @ whole @ R.T, atol=1e-12)
    assert (support.residual, support.n_inliers) == (1.3, 15)
    # It is linked where the map covers it.
    np.testing.assert_allclose(support.links.target, T_WALK.apply(POSITIONS[:15]), atol=1e-12)
    np.testing.assert_allclose(support.links.base, T.apply(support.links.target), atol=1e-12)
    assert (support.sensor, support.fitness, support.statistics) == (None, None, {})


def test_along_a_path_settling_leaves_a_pose_as_it_was_weighed():
    stated, settled = STRATEGY.state(PAIR, BEST)[0], STRATEGY.settle(PAIR, BEST)[0]
    np.testing.assert_array_equal(settled.covariance, stated.covariance)
    np.testing.assert_array_equal(settled.T_base_target.as_matrix(), stated.T_base_target.as_matrix())


def test_the_drift_of_a_walk_that_bends_is_that_of_its_frame_already():
    R = np.kron(np.eye(2), T_WALK.rotation.as_matrix())
    estimate, _ = STRATEGY.state(PAIR, replace(BEST, drift=np.diag(SD**2) / 2))
    np.testing.assert_allclose(estimate.covariance, R @ np.diag(SD**2) @ R.T, atol=1e-12)


def test_drift_is_named_where_without_it_the_pose_would_be_known_well_enough():
    def said(sd, status=Status.DEGENERATE, drift=0.75):
        config = DecisionConfig(max_sd_translation=sd, max_sd_rotation=1.0)
        walk = replace(BEST, model="drifts by 0.1 m per root of a metre", drift=drift and np.diag(drift * SD**2))
        return _naming_drift(Verdict(status, "known too little"), PAIR, walk, None, config).reason

    named = "the target's positions or orientations drift, by 0.1 m per root of a metre; "
    # Known to 0.06 m with its drift, to half of that without.
    assert said(0.04).startswith(named)
    assert said(0.04).endswith("; known too little")
    assert said(0.02) == said(0.04, Status.AMBIGUOUS) == said(0.04, drift=None) == "known too little"
