# SPDX-License-Identifier: BSD-3-Clause
"""Two logs share a frame if the windows that did not propose it say so too."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from magmatch.runner import Runner
from magmatch.slam.decide import log_odds_shared
from magmatch.slam.graph.solve import forget_closures
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.search.comparison import Candidate
from magmatch.slam.search.loop_closure import Match

HERE = RigidTransform.identity()
AT_ONCE, NOWHERE = -2.0, -7.0  # log densities of the prior: given the closure, and from nowhere


def candidate(log_odds):
    match = Match(HERE, np.eye(6) * 1e-3, log_odds, AT_ONCE, HERE, np.eye(6) * 1e-3)
    return Candidate(0, RigidTransform.identity(), match)


def unconnected(session):
    places = session.places.copied()
    forget_closures(places.graph)
    return places


@pytest.fixture(scope="module")
def connected(three):
    """Two logs of one place as slam left them, and what a closure at the second one's first window would say."""
    a, b, _ = three.session.places.paths

    def odds(of_windows):
        found = [[] if x is None else [candidate(x)] for x in of_windows]
        graph = three.session.graph
        return log_odds_shared(b.windows, corrected(a, graph).positions, found, {b.first_node: NOWHERE}, graph)

    return odds, len(b.windows)


@given(st.data())
def test_more_agreement_never_lowers_the_odds(connected, data):
    odds, n = connected
    said = data.draw(st.lists(st.floats(-30, 30), min_size=n, max_size=n))
    k, more = data.draw(st.integers(0, n - 1)), data.draw(st.floats(0, 10))
    assert odds([x + more * (j == k) for j, x in enumerate(said)]) >= odds(said) - 1e-9


@given(st.data())
def test_a_window_adds_at_most_its_odds_and_a_silent_one_nothing(connected, data):
    odds, n = connected
    alone = [5.0] + [None] * (n - 1)
    assert odds(alone) == pytest.approx(5.0 - AT_ONCE + NOWHERE)  # it pays for the transform
    k, said = data.draw(st.integers(1, n - 1)), data.draw(st.floats(-30, 30))
    gain = odds([said if j == k else x for j, x in enumerate(alone)]) - odds(alone)
    assert min(said, np.log(1 - 0.8)) - 1e-9 <= gain <= max(said, 0.0) + 1e-9


def test_without_a_window_that_proposed_it_nothing_is_shared(connected):
    odds, n = connected
    assert odds([None] + [9.0] * (n - 1)) == -np.inf


def test_a_stranger_that_one_window_takes_for_known_path_is_not_connected(three):
    places = unconnected(three.session)
    a, _, stranger = places.paths
    C = np.diag([0.02, 0.02, 0.02, 0.1, 0.1, 0.05]) ** 2
    said = Match(a.windows[1].T_log_node, C, 12.0, NOWHERE, HERE, C)
    candidates = [[] for _ in stranger.windows]
    candidates[0] = [Candidate(a.first_node + 1, RigidTransform.identity(), said)]
    before = places.graph.p.copy()
    closer = LoopCloser(places, Runner())
    assert closer.connect(stranger, candidates) == 0
    np.testing.assert_array_equal(places.graph.p, before)
    assert not places.graph.closures
    # Nor is any noise learned from where the refused closure put its windows.
    assert not closer.search.predicted


def test_a_log_of_the_same_place_is_connected_by_one_window_too(three):
    places = unconnected(three.session)
    _, b, _ = places.paths
    closures = [c for c in three.session.graph.closures if places.graph.log[c.first] != places.graph.log[c.second]]
    sure = max(closures, key=lambda c: c.log_odds)
    said = Match(HERE, sure.covariance, 12.0, NOWHERE, HERE, sure.covariance)
    candidates = [[] for _ in b.windows]
    candidates[sure.second - b.first_node] = [Candidate(sure.first, sure.T_first_second, said)]
    found = LoopCloser(places, Runner()).connect(b, candidates)
    assert found > 1  # the windows beside it close as well
    assert places.graph.closures[0].first == sure.first
