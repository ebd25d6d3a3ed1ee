# SPDX-License-Identifier: BSD-3-Clause
"""What is believed: windows along a log, poses about one place, and whether two logs share a frame."""

from dataclasses import replace
from itertools import pairwise, product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.runner import Runner
from magmatch.slam.decide import Weighted, by_pass, closure_beside, log_odds_shared, same_answer, smooth
from magmatch.slam.graph.solve import forget_closures
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.search.loop_closure import Candidate, Match

HERE = RigidTransform.identity()
AT_ONCE, NOWHERE = -2.0, -7.0  # log densities of the prior: given the closure, and from nowhere
REVISIT, KEEPS_ON = 0.4, 0.8


def candidate(node, T, C, log_odds=3.0):
    return Candidate(node, T, Match(HERE, C, log_odds, AT_ONCE, HERE, C))


# What forward and backward sums give is what enumerating every course gives.


def placed(log_odds, log_prior):
    return SimpleNamespace(log_odds=log_odds, log_prior=log_prior)


@st.composite
def chains(draw):
    sizes = draw(st.lists(st.integers(0, 2), min_size=1, max_size=4))
    number = st.floats(-8, 8)
    windows = [[placed(draw(number), draw(st.floats(-6, 0))) for _ in range(n)] for n in sizes]
    steps = [np.array([draw(number) for _ in range(a * b)]).reshape(a, b) for a, b in pairwise(sizes)]
    return windows, steps, [draw(st.sampled_from([REVISIT, 0.99])) for _ in sizes]


def enumerated(windows, steps, revisits):
    """Probabilities from the weight of every course of states; state 0 is nowhere."""
    found, total = [np.zeros(len(w)) for w in windows], 0.0
    for course in product(*(range(len(w) + 1) for w in windows)):
        density = [0.0 if s == 0 else np.exp(w[s - 1].log_prior) for w, s in zip(windows, course, strict=True)]
        weight = (1 - revisits[0]) if course[0] == 0 else revisits[0] * density[0]
        for k, (s, t) in enumerate(pairwise(course)):
            rho, leaves = revisits[k + 1], 1 - KEEPS_ON
            enters = min(leaves * rho / (1 - rho), rho)
            if s == 0:
                weight *= 1 - enters if t == 0 else enters * density[k + 1]
            elif t == 0:
                weight *= leaves
            else:
                weight *= KEEPS_ON * np.exp(steps[k][s - 1, t - 1]) + leaves * rho * density[k + 1]
        for w, s in zip(windows, course, strict=True):
            weight *= 1.0 if s == 0 else np.exp(w[s - 1].log_odds - w[s - 1].log_prior)
        total += weight
        for k, s in enumerate(course):
            if s:
                found[k][s - 1] += weight
    return [f / total for f in found]


@given(chains())
def test_the_sums_are_those_of_all_courses(chain):
    for ours, theirs in zip(smooth(*chain, KEEPS_ON), enumerated(*chain), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


# A window that fits at several poses about one place gives one closure, as uncertain as they differ.


def pose(x, y=0.0, turn=0.0):
    return RigidTransform.from_components([x, y, 0.0], Rotation.from_rotvec([0, 0, turn]))


def test_poses_within_a_field_length_are_one_answer_and_those_beyond_or_turned_are_not(lone):
    window = lone.session.paths[0].windows[5]
    one, turn = window.length, 2 * window.length / window.path_length
    poses = [pose(0.0), pose(0.9 * one), pose(1.1 * one), pose(0.0, turn=0.9 * turn), pose(0.0, turn=1.1 * turn)]
    assert same_answer(poses, np.array([0.4, 0.3, 0.1, 0.15, 0.05]), window).tolist() == [0, 1, 3]
    assert not len(same_answer([], np.zeros(0), window))


def test_the_closure_has_mean_and_covariance_of_all_that_may_be(lone):
    graph, path = lone.session.graph, lone.session.paths[0]
    rng = np.random.default_rng(0)
    near, far = np.diag([0.01, 0.01, 0.03, 0.05, 0.1, 0.02]) ** 2, np.diag([0.01, 0.01, 0.05, 0.2, 0.1, 0.02]) ** 2
    first, last = path.nodes[2], path.nodes[-3]
    # The second lies beside the next node of the same pass.
    step = graph.center(first).inv() * graph.center(first + 1)
    some = [candidate(first, pose(0.1, 0.2), near), candidate(first + 1, step.inv() * pose(0.6, 0.1, 0.1), far)]
    closure = closure_beside([Weighted(some[0], 0.6), Weighted(some[1], 0.2)], last, [path], 2.0, graph)
    alone = closure_beside([Weighted(some[0], 0.6)], last, [path], 2.0, graph)
    np.testing.assert_allclose(alone.T_first_second.as_matrix(), pose(0.1, 0.2).as_matrix(), atol=1e-12)
    # Drawn: three of four from the first.
    n, base = 40_000, alone.T_first_second
    draws = []
    for T, C, share in ((pose(0.1, 0.2), near, 0.75), (pose(0.6, 0.1, 0.1), far, 0.25)):
        xi = rng.standard_normal((int(share * n), 6)) * np.sqrt(np.diag(C))
        off = base.inv() * T * RigidTransform.from_components(xi[:, 3:], Rotation.from_rotvec(xi[:, :3]))
        draws.append(np.hstack([off.rotation.as_rotvec(), off.translation]))
    drawn = np.vstack(draws)
    off = base.inv() * closure.T_first_second
    found = np.concatenate([off.rotation.as_rotvec(), off.translation])
    np.testing.assert_allclose(found, drawn.mean(axis=0), atol=0.01)
    added = closure.covariance - alone.covariance
    np.testing.assert_allclose(np.diag(added), np.diag(np.cov(drawn.T)) - np.diag(near), atol=5e-3)


@pytest.mark.parametrize(("log_odds", "passes"), [(1.0, 2), (-1.0, 1)])
def test_another_pass_closes_too_unless_it_speaks_against_the_place(three, log_odds, passes):
    graph, (a, b, _) = three.session.graph, three.session.places.paths
    C = np.eye(6)
    some = [candidate(a.first_node, HERE, C), candidate(a.first_node + 1, HERE, C)]
    some.append(replace(candidate(b.first_node, HERE, C, log_odds)))
    groups = by_pass(some, np.array([0.5, 0.3, 0.2]), graph)
    assert [[one.probability for one in group] for group in groups] == [[0.5, 0.3], [0.2]][:passes]


# Two logs share a frame if the windows that did not propose it say so too.


def unconnected(session):
    places = session.places.copied()
    forget_closures(places.graph)
    return places


@pytest.fixture(scope="module")
def connected(three):
    """Two logs of one place as slam left them, and what a closure at the second one's first window would say."""
    a, b, _ = three.session.places.paths

    def odds(of_windows):
        found = [[] if x is None else [candidate(0, HERE, 1e-3 * np.eye(6), x)] for x in of_windows]
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
