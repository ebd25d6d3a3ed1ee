# SPDX-License-Identifier: BSD-3-Clause
"""Merge: rigid surveys find one frame, strangers stay apart, and a registration that is wrong is outvoted."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import kstest

from drifting import GIVEN, Place
from hand_made import exp_se3, log_se3
from magmatch.data.survey import Survey
from magmatch.errors import ConfigurationError
from magmatch.field.build import build_map
from magmatch.geometry import random_transform, transform_error
from magmatch.registration.config import PRESETS
from magmatch.registration.register import register
from magmatch.slam import merge as merging
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.solve import solve, surprises
from magmatch.slam.merge import merge
from magmatch.slam.result import SlamStatus
from other_process import elsewhere

RNG = np.random.default_rng(4)
# Frames of the surveys, from the room's: far from their samples, where every turn is a large shift.
FRAMES = [random_transform(RNG, 30.0) for _ in range(4)]


def surveyed(seed, low, high, frame, name, n=500):
    """Samples scattered in a part of a place."""
    rng = np.random.default_rng([seed, n, int(10 * low + 100)])
    place = Place(seed, n=30)
    p = rng.uniform((low, -1.0, -0.2), (high, 1.0, 0.5), (n, 3))
    survey = Survey(p, place.field(p) + 2e-7 * rng.standard_normal((n, 3)), name=name)
    return survey.transformed(frame)


@pytest.fixture(scope="module")
def surveys():
    """Three that overlap in turn, the first and the third hardly, and one of another place."""
    parts = [(-3.0, 0.4), (-1.6, 1.8), (-0.4, 3.0)]
    own = [surveyed(3, *part, T, f"s{k}.csv") for k, (part, T) in enumerate(zip(parts, FRAMES[:3], strict=True))]
    return [*own, surveyed(8, -1.5, 1.5, FRAMES[3], "stranger.csv")]


@pytest.fixture(scope="module")
def session(surveys):
    return merge(surveys)


@pytest.fixture(scope="module")
def maps(surveys):
    return [build_map(survey, PRESETS["default"].field) for survey in surveys[:2]]


def test_maps_that_hold_a_log_in_common_are_said_to(surveys, caplog):
    """Its samples agree with themselves, whichever frame either map is in."""
    a, b, c = surveys[0], surveys[1], surveys[2]
    one, other = (build_map([first, b], GIVEN) for first in (a, c))
    merging._warn_of_shared_logs([one, a.transformed(FRAMES[1]), other])
    assert caplog.text.count("count twice") == 2
    assert "s0.csv+s1.csv and s0.csv hold the same samples (s0.csv)" in caplog.text
    caplog.clear()
    merging._warn_of_shared_logs([one, other.transformed(FRAMES[3])])
    assert "hold the same samples (s1.csv)" in caplog.text
    caplog.clear()
    merging._warn_of_shared_logs([a, b, build_map(c, GIVEN)])
    assert "same samples" not in caplog.text


def test_surveys_that_overlap_share_a_frame_and_a_stranger_stays_apart(session, surveys):
    result = session.result()
    assert sorted(map(sorted, session.components)) == [[0, 1, 2], [3]]
    assert result.status is SlamStatus.PARTLY_CONNECTED
    assert result.logs[3].T_map_log is None
    for k in (1, 2):
        T_true = FRAMES[0] * FRAMES[k].inv()
        shift, turn = transform_error(result.logs[k].T_map_log, T_true, surveys[k].centroid)
        place, angle = result.logs[k].sd
        assert shift < max(4 * place, 0.02)
        assert turn < max(4 * angle, 0.01)


def test_surveys_stay_rigid_and_keep_their_fields(session, surveys):
    for k, after in enumerate(session.trajectories):
        moved = surveys[k].transformed(session.T_map_log(k))
        np.testing.assert_allclose(after.positions, moved.positions, atol=1e-9)
        np.testing.assert_allclose(after.field, moved.field, atol=1e-15)
    # As a whole: none of them was bent.
    assert max(log.moved for log in session.result().logs) < 1e-9


def test_a_pair_is_stated_as_registration_states_it(session, maps):
    direct = register(*maps)
    (stated,) = [c for c in session.result().closures if (c.log_a, c.log_b) == ("s0", "s1")]
    np.testing.assert_allclose(stated.T_a_b.as_matrix(), direct.T_base_target.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(stated.covariance, direct.covariance, rtol=1e-6, atol=1e-12)
    assert stated.probability == pytest.approx(direct.probability, abs=1e-9)
    assert stated.t_a is None


def test_maps_are_taken_as_the_surveys_they_were_made_of_in_other_processes_with_the_same_bits(
    surveys, maps, session
):
    here, elsewhere_too = merge(surveys[:2]), merge(maps, run=elsewhere)
    both = elsewhere_too.result()
    assert both.status is SlamStatus.CONNECTED
    assert [entry["sha256"] for entry in both.inputs] == [entry["sha256"] for entry in session.result().inputs[:2]]
    np.testing.assert_array_equal(elsewhere_too.graph.p, here.graph.p)
    np.testing.assert_array_equal(elsewhere_too.graph.R, here.graph.R)
    assert [c.log_odds for c in elsewhere_too.graph.closures] == [c.log_odds for c in here.graph.closures]


TRUE = [random_transform(np.random.default_rng(k)) for k in range(5)]
C = np.diag([1e-3] * 3 + [5e-3] * 3) ** 2


def graph_of(seed, odds, wrong=None):
    """Five surveys, laid out by all pairs: of errors drawn from what is stated, but for one pair of larger odds."""
    rng, graph = np.random.default_rng(seed), merging._unconnected(np.zeros((5, 3)))
    graph.closures = [
        Closure(a, b, TRUE[a].inv() * TRUE[b] * exp_se3(np.sqrt(np.diag(C)) * rng.normal(size=6)), C, odds)
        for a, b in combinations(range(5), 2)
    ]
    if wrong:
        error = exp_se3(np.array([0.0, 0.0, 0.4, 1.0, -0.5, 0.2]))
        graph.closures = [
            replace(c, T_first_second=TRUE[c.first].inv() * TRUE[c.second] * error, log_odds=odds + 1)
            if (c.first, c.second) == wrong else c
            for c in graph.closures
        ]  # fmt: skip
    merging._lay_out(graph)
    for _ in range(2):  # factors are of where a solution began
        solve(graph)
    return graph


def test_what_right_registrations_leave_against_the_others_is_chi_square_of_six():
    """Each pair against what the other nine predict."""
    found = np.concatenate([surprises(graph_of(seed, 12.0))[0] for seed in range(5)])
    assert kstest(found, "chi2", (6,)).pvalue > 0.01


def test_a_registration_that_the_others_contradict_is_voted_out():
    """The least squares begins with the wrong one believed."""
    graph = graph_of(0, 7.0, wrong=(1, 3))
    weights = {(c.first, c.second): c.weight for c in graph.closures}
    assert weights.pop((1, 3)) < 0.01
    # Of nine that are right one is in the tail beyond a hundredth.
    assert min(weights.values()) > 0.8
    for k, T in enumerate(TRUE):
        assert np.abs(log_se3((TRUE[0] * graph.pose(k)).inv() * T)).max() < 0.02


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (lambda s: [s], ValueError, "at least two"),
        (lambda s: s, TypeError, "takes several"),
        (lambda s: [s, "b.csv"], TypeError, r"surveys\[1\].*read_survey"),
        (lambda s: [s, s], ValueError, "only once"),
        (lambda s: [s, replace(s, positions=np.zeros_like(s.positions))], ValueError, "one point"),
    ],
)
def test_what_cannot_be_merged_is_refused_in_one_sentence(surveys, given, error, words):
    with pytest.raises(error, match=words):
        merge(given(surveys[0]))


def test_the_published_method_knows_no_covariance(surveys):
    with pytest.raises(ConfigurationError, match="covariance"):
        merge(surveys, PRESETS["paper"])
