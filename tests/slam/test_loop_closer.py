# SPDX-License-Identifier: BSD-3-Clause
"""A log that may be anywhere on its earlier path: where it is searched for, and what ties it there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.registration.search.retrieval import shortlist
from magmatch.runner import Runner
from magmatch.slam.decide import probable_closures
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.solve import forget_closures
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.loop_search import LoopSearch

# Log densities of a prior that knows a place to some hundred metres.
NOWHERE = -14.0


@pytest.fixture
def closed(lone):
    """The log without closures, and those that it had."""
    places = lone.session.places.copied()
    closures = [replace(c, weight=1.0) for c in places.graph.closures if c.is_kept]
    forget_closures(places.graph)
    return places, closures


def test_a_window_that_may_be_anywhere_votes_for_the_stretch_that_it_lies_on(closed):
    places, closures = closed
    windows, hits, search = places.paths[0].windows, 0, LoopSearch(places, Runner())
    for c in closures:
        nodes = places.known_to(windows[c.second])
        firsts = np.array(list(search.by_submap(nodes, windows[c.second])))
        votes = search.votes(windows[c.second], firsts.tolist())
        assert list(votes) == firsts.tolist()
        voted = firsts[shortlist(np.array(list(votes.values())))]
        assert set(voted) <= set(nodes)
        hits += np.abs(voted - c.first).min() <= 1
    assert hits >= 0.8 * len(closures)


def test_closures_that_agree_are_believed_against_odometry_even_if_each_was_doubted(closed):
    """Else drift is learned from those that agree with odometry, and what it learns confirms the doubt."""
    places, closures = closed
    graph, middle = places.graph, len(places.graph.p) // 2
    # As if odometry had been off by half a field length on its way from one half of the closures' nodes to the other.
    off = np.array([places.maker.length / 2, 0.0, 0.0])
    graph.closures = [
        replace(
            c,
            T_first_second=RigidTransform.from_translation(graph.R[c.first].T @ off) * c.T_first_second,
            log_odds=2.5,
            weight=0.0,
        )
        for c in closures
        if c.first < middle <= c.second
    ]
    places.solve()
    assert len(graph.closures) > 2
    assert all(c.is_kept for c in graph.closures)
    LoopCloser(places, Runner()).learn_drift()
    assert all(c.is_kept for c in places.graph.closures)


def test_a_window_whose_place_the_graph_knows_needs_less_evidence_than_one_that_may_be_anywhere(closed):
    places, closures = closed
    best = max(closures, key=lambda c: c.log_odds)
    window = places.paths[0].windows[best.second]
    found = [c for c in LoopSearch(places, Runner()).near([window])[0] if c.node == best.first]
    weak = [replace(c, match=replace(c.match, log_odds=-2.0)) for c in found[:1]]
    path = places.paths[0].only(slice(best.second, best.second + 1))
    assert not probable_closures(path, [weak], places.graph, places.paths)
    precise = places.graph.config.odometry.model_copy(update={"sd": (0.1, 1.0)})
    config = places.graph.config.model_copy(update={"odometry": precise})
    places.graph.edges, places.graph.config = odometry_graph(places.paths, config).edges, config
    places.solve()
    assert probable_closures(path, [weak], places.graph, places.paths)


def test_a_tie_is_kept_if_the_windows_beside_it_agree_and_else_leaves_the_graph_as_it_was(closed):
    places, closures = closed
    path, best = places.paths[0], max(closures, key=lambda c: c.log_odds)
    before, nowhere = places.graph.p.copy(), SimpleNamespace(log_prior=NOWHERE)
    proposed = [[SimpleNamespace(node=best.first, match=nowhere)]] * len(path.windows)
    ahead = RigidTransform.from_translation([2.5 * places.maker.length, 0.0, 0.0])
    for tie, is_kept in ((replace(best, T_first_second=best.T_first_second * ahead), False), (best, True)):
        found = LoopCloser(places, Runner()).confirm(path, proposed, [tie], path.nodes, path.windows)
        assert (found is not None, len(places.graph.closures)) == (is_kept, is_kept)
        assert is_kept or np.array_equal(places.graph.p, before)
