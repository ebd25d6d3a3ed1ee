# SPDX-License-Identifier: BSD-3-Clause
"""With hindsight more poses are stated, and none is worse."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.localization.estimate import Estimate, LocalizerStatus
from magmatch.localization.smooth import _join, reversed_log, smooth

NO_BIAS = np.zeros(3)


def estimate(x, sd, name="hall"):
    T = RigidTransform.from_translation([x, 0.0, 0.0])
    return Estimate(
        LocalizerStatus.LOCALIZED,
        "",
        T.as_matrix(),
        np.diag([1e-4] * 3 + [sd**2] * 3),
        0.999,
        NO_BIAS,
        NO_BIAS,
        1.0,
        name,
    )


def test_hindsight_knows_the_beginning_too_and_errs_less(place, followed):
    track = smooth(place, followed.log)
    live = followed.track
    assert track.is_stated[:10].all()
    assert track.is_stated.mean() > live.is_stated.mean()
    both = track.is_stated & live.is_stated
    found = [
        np.array([e.T_map_body.translation for e, s in zip(t.estimates, both, strict=True) if s])
        for t in (track, live)
    ]
    rms = [np.sqrt(((p - followed.truth[both]) ** 2).sum(axis=1).mean()) for p in found]
    assert rms[0] < rms[1]


def test_a_log_reversed_twice_is_the_log(followed):
    again = reversed_log(reversed_log(followed.log))
    np.testing.assert_array_equal(again.positions, followed.log.positions)
    np.testing.assert_array_equal(again.times, followed.log.times)


def test_two_estimates_meet_by_their_weights_and_claim_no_more_than_the_better():
    met = _join(estimate(0.0, 0.1), estimate(0.3, 0.2))
    # Weights 1 / 0.01 and 1 / 0.04.
    np.testing.assert_allclose(met.T_map_body.translation, [0.06, 0.0, 0.0], atol=1e-9)
    assert met.covariance[3, 3] >= 0.01


def test_two_estimates_that_contradict_each_other_state_nothing():
    assert not _join(estimate(0.0, 0.1), estimate(3.0, 0.1)).is_stated
    assert not _join(estimate(0.0, 0.1), estimate(0.0, 0.1, "cellar")).is_stated
