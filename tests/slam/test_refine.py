# SPDX-License-Identifier: BSD-3-Clause
"""The last look: windows on one map of their log's earlier passes, and on one of its later passes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drifting import trajectory_error
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.solve import solve
from magmatch.slam.run import slam


def test_laps_are_placed_on_a_map_of_the_earlier_ones_and_on_one_of_the_later_ones(many_laps):
    graph, last = many_laps.session.graph, many_laps.session.paths[0].nodes[-1]
    forward = [f for f in graph.submap_factors if f.passes[0] < f.node]
    backward = [f for f in graph.submap_factors if f.passes[0] > f.node]
    for factor in graph.submap_factors:
        assert factor.part == 0.5
        assert factor.shares.sum() == pytest.approx(1.0)
        assert len(factor.passes) >= 2
        assert not graph.is_one_pass(factor.passes, factor.node).any()
    assert all((f.passes < f.node).all() for f in forward)
    assert all((f.passes > f.node).all() for f in backward)
    assert max(f.node for f in forward) >= last - 2
    assert min(f.node for f in backward) <= 2
    assert abs(len(forward) - len(backward)) <= 2


def test_poses_on_maps_are_nearer_to_the_truth_than_closures_and_in_both_orders_nearer_than_in_one(many_laps):
    every = many_laps.session.graph.submap_factors

    def error(*factors):
        places = many_laps.session.places.copied()
        places.graph.submap_factors = factors
        solve(places.graph)
        return trajectory_error(many_laps.truth, replace(many_laps.session, places=places).trajectories[0].positions)

    forward, backward = (
        [replace(f, part=1.0) for f in every if (f.passes > f.node).all() == k] for k in (False, True)
    )
    both = error(*every)
    assert both < 0.9 * min(error(*forward), error(*backward))
    assert both < 0.7 * error()


def test_submap_factors_are_as_far_off_as_they_state(many_laps):
    """Where a node is relative to each pass, by shares, in the axes that odometry had there.

    One that counts as half the likelihood counts as one of twice the covariance.
    """
    path, graph, squares = many_laps.session.paths[0], many_laps.session.graph, []
    truth = many_laps.truth[path.middles]
    ahead = np.gradient(many_laps.truth, axis=0)[path.middles]
    # Odometry's axes, against true ones: the body looks ahead.
    true = Rotation.from_rotvec(np.arctan2(ahead[:, 1], ahead[:, 0])[:, None] * [0, 0, 1])
    turned = true * many_laps.log.orientations[path.middles].inv()
    for f in graph.submap_factors:
        seen = sum(share * turned[first].apply(t) for first, share, t in zip(f.passes, f.shares, f.t, strict=True))
        off = (seen - truth[f.node] + f.shares @ truth[f.passes])[:2]
        C = turned[f.node].as_matrix() @ f.covariance[3:, 3:] @ turned[f.node].as_matrix().T
        squares.append(f.part * off @ np.linalg.solve(C[:2, :2], off) / 2)
    assert 0.2 < np.mean(squares) < 2.5


@pytest.mark.slow
def test_fixed_points_at_another_height_leave_factors_as_they_are(many_laps):
    log, path = many_laps.log, many_laps.session.paths[0]
    rows = path.middles[[0, 3, 6, 9]]
    up = np.array([0.0, 0.0, 3.0])
    anchors = [Anchor("walk", float(log.times[k]), many_laps.truth[k] + up, 0.02) for k in rows.tolist()]
    session = slam(log, anchors=anchors)
    assert session.graph.is_fixed(0)
    n = len(many_laps.session.graph.submap_factors)
    assert abs(len(session.graph.submap_factors) - n) <= 2
    off = session.trajectories[0].positions - many_laps.truth
    assert np.abs(off[:, 2] - 3.0).max() < 0.05
    assert np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()) < 0.1
