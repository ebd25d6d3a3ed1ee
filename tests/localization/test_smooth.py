# SPDX-License-Identifier: BSD-3-Clause
"""With hindsight more poses are stated, and none is worse."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.localization.hindsight import REFUTED, agreement, believed, in_order, join, stretches
from magmatch.localization.localize import localize


def estimate(x, sd, name="hall"):
    T = RigidTransform.from_translation([x, 0.0, 0.0])
    covariance = np.diag([1e-4] * 3 + [sd**2] * 3)
    return PoseEstimate(LocalizerStatus.LOCALIZED, "", T.as_matrix(), covariance, 0.999, map=name)


def test_hindsight_knows_the_beginning_too_and_errs_less(place, followed):
    track = localize(place, followed.log)
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


def test_two_estimates_meet_by_their_weights_and_state_nothing_where_they_contradict_each_other():
    (met,) = join([estimate(0.0, 0.1)], [estimate(0.3, 0.2)])
    # Weights 1 / 0.01 and 1 / 0.04; no more is claimed than by the better.
    np.testing.assert_allclose(met.T_map_body.translation, [0.06, 0.0, 0.0], atol=1e-9)
    assert met.covariance[3, 3] >= 0.01
    apart = join([estimate(0.0, 0.1)] * 2, [estimate(3.0, 0.1), estimate(0.0, 0.1, "cellar")])
    assert not any(one.is_stated for one in apart)


LOST, UNCERTAIN = (PoseEstimate(LocalizerStatus.LOST, "", is_place_known=known) for known in (False, True))
STEPS = np.ones(10)


def standing(forward, backward, tested=3.0):
    """Rows of the forward direction that stand; one sample each metre."""
    found = believed(forward, *agreement(forward, backward), STEPS, tested)
    return [n for n, e in enumerate(found) if e.is_stated]


def at(*rows, x=0.0, otherwise=LOST):
    return [estimate(x, 0.1) if n in rows else otherwise for n in range(10)]


def test_a_stretch_that_what_follows_contradicts_stands_only_as_far_as_the_other_direction_agrees():
    assert standing(at(1, 2, 3, 4, 5), at()) == []
    assert standing(at(1, 2, 3, 4, 5), at(2, 3)) == [1, 2, 3]
    assert standing(at(1, 2, 3, 4, 5), at(2, 3, x=2.0)) == []
    # Or its earlier part, where it had stood before.
    assert standing(at(*range(9)), at()) == [0, 1, 2, 3, 4, 5]
    assert standing(at(*range(9)), at(*range(9), x=3.0)) == []
    # A pose that became too uncertain contradicts nothing.
    assert standing(at(1, 2, 3, 4, 5, otherwise=UNCERTAIN), at()) == [1, 2, 3, 4, 5]


def test_a_fix_at_the_very_end_has_not_been_put_to_the_test():
    assert standing(at(8, 9), at()) == []
    assert standing(at(8, 9), at(8, 9)) == [8, 9]
    assert standing(at(5, 6, 7, 8, 9), at()) == [5, 6, 7, 8, 9]


def test_path_outside_the_map_puts_a_fix_to_no_test():
    inside = at(*range(10))
    outside = inside[:3] + [replace(e, status=LocalizerStatus.DEAD_RECKONING) for e in inside[3:]]
    assert standing(outside, at()) == []
    assert standing(outside, at(1)) == [0, 1]
    assert standing(inside, at()) == list(range(10))


def test_of_two_stretches_that_disagree_neither_stands():
    assert standing(at(5, 6, 7, 8, 9), at(*range(10), x=3.0)) == []
    assert standing(at(*range(10), x=3.0), at(5, 6, 7, 8, 9)) == []


def test_a_stretch_ends_where_another_map_is_named():
    walk = [estimate(0.0, 0.1), estimate(0.0, 0.1, "cellar"), UNCERTAIN]
    assert stretches(walk) == [(0, 1), (1, 2)]


def test_only_a_stretch_that_something_contradicts_is_refuted():
    def rows(forward, backward):
        found = believed(forward, *agreement(forward, backward), STEPS, 30.0)
        return [n for n, e in enumerate(found) if e.reason == REFUTED]

    assert rows(at(8, 9), at()) == []
    assert rows(at(4, 5, otherwise=UNCERTAIN), at()) == []
    assert rows(at(4, 5), at()) == [4, 5]
    assert rows(at(8, 9), at(8, 9, x=2.0)) == [8, 9]


def test_a_fix_that_nothing_contradicts_is_said_to_wait_for_its_test(place, followed):
    # The walk ends before the map has known the body for 1.5 m (2.5 field lengths) in either direction.
    first = int(np.argmax([e.probability >= 0.99 for e in followed.track.estimates]))
    track = localize(place, followed.log.subset(np.arange(first + 5)))
    said = [e.reason for e in track.estimates]
    assert not track.is_stated.any()
    assert REFUTED not in said
    assert "it is stated once it has stood" in track.result().reason
    assert track.estimates[-1].probability >= 0.99


def test_what_is_unstated_is_searched_for_before_the_first_stated_pose_and_lost_after_it():
    searching = PoseEstimate(LocalizerStatus.SEARCHING, "", probability=0.5)
    joined = in_order(join(at(3, 7), at(3, otherwise=searching)))
    words = [e.status.value for e in joined]
    assert words == ["searching"] * 3 + ["localized"] + ["lost"] * 3 + ["localized"] + ["lost"] * 2
    assert {e.status for e in in_order(join(at(), at()))} == {LocalizerStatus.SEARCHING}


@pytest.mark.parametrize("live", [False, True])
def test_no_stated_pose_is_less_accurate_than_asked_for(place, followed, live):
    # Beyond half the errors that the walk has otherwise.
    limit = float(np.median(followed.track.sd[:, 0]))
    config = LocalizerConfig()
    decision = config.decision.model_copy(update={"max_sd_translation": limit})
    track = localize(place, followed.log, config.model_copy(update={"decision": decision}), live=live)
    assert track.is_stated.any()
    assert track.sd[:, 0].max() <= limit
    assert any("too uncertain" in e.reason and e.is_place_known for e in track.estimates)
