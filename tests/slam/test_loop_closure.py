# SPDX-License-Identifier: BSD-3-Clause
"""Poses of windows near where the graph expects them."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from magmatch.registration.search.candidate import SearchResult
from magmatch.slam import loop_closure
from magmatch.slam.graph.pose_graph import LEVEL_SD, UPRIGHT_SD
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


def test_the_prior_that_neighbours_replace_is_of_what_drifts_alone(lone):
    """Else a pose that leans against gravity would be as likely as a neighbour predicts its place."""
    places = lone.session._now
    closure = max(places.graph.closures, key=lambda c: c.log_odds)
    window = places.paths[0].windows[closure.second]
    T_expected = places.graph.center(closure.first) * closure.T_first_second
    sd = np.array([0.001, 0.001, 0.1, 0.2, 0.2, 0.001])
    rough = Rough(T_expected * window.T_log_node.inv(), np.diag(sd**2))
    for match in matches(window, places.stretch(closure.first, closure.second), window.config, rough):
        off = T_expected.inv() * match.T_base_log * window.T_log_node
        turn, (x, y, _) = off.rotation.as_rotvec()[2], off.translation
        of_node = [UPRIGHT_SD, LEVEL_SD, LEVEL_SD]
        expected = multivariate_normal.logpdf([turn, x, y], cov=np.diag(sd[2:5] ** 2 + np.square(of_node)))
        assert match.log_prior == pytest.approx(expected)
