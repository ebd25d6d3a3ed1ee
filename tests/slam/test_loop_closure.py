# SPDX-License-Identifier: BSD-3-Clause
"""Poses of windows near where the graph expects them."""

import numpy as np

from magmatch.registration.search.candidate import SearchResult
from magmatch.slam import loop_closure
from magmatch.slam.loop_closure import Rough, matches


def test_where_the_search_finds_nothing_the_graph_s_expectation_is_a_pose_to_begin_from(lone, monkeypatch):
    monkeypatch.setattr(loop_closure, "pair_search", lambda *_: SearchResult())
    places = lone.session._now
    closure = max(places.graph.closures, key=lambda c: c.log_odds)
    window = places.paths[0].windows[closure.second]
    T = places.graph.center(closure.first) * closure.T_first_second * window.T_log_node.inv()
    rough = Rough(T, np.diag([0.01, 0.01, 0.1, 0.2, 0.2, 0.05]) ** 2)
    (found, *_) = matches(window, places.stretch(closure.first, closure.second), window.config, rough)
    assert np.linalg.norm(found.T_base_log.apply(window.center) - T.apply(window.center)) < 0.1
    assert found.log_odds > 0
    assert not matches(window, places.stretch(closure.first, closure.second), window.config, 100.0)
