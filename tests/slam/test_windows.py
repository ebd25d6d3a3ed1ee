# SPDX-License-Identifier: BSD-3-Clause
"""Logs in windows: every sample in one, in order, of equal path; between them a correction changes evenly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from drifting import Place, drifting_walk
from magmatch.data.survey import Survey
from magmatch.preparation.odometry.drift import lie_level
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.graph.solve import solve
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.windows import cut

LOG, _ = drifting_walk(Place(1), 1)
CONFIG = SlamConfig(window_length=6.0, is_planar=True)


@given(st.lists(st.floats(0.3, 2.0), min_size=1, max_size=3), st.floats(0.2, 3.0))
@settings(max_examples=20, deadline=None)
def test_every_sample_lies_in_one_window_and_nodes_count_on(laps, length):
    logs = [drifting_walk(Place(1), k, laps=some)[0] for k, some in enumerate(laps)]
    paths = cut(logs, length, CONFIG)
    assert [node for path in paths for node in path.nodes] == list(range(sum(len(p.windows) for p in paths)))
    for k, (log, path) in enumerate(zip(logs, paths, strict=True)):
        assert len(path.number) == len(log)
        assert (np.diff(path.number) >= 0).all()
        assert sum(len(w.survey) for w in path.windows) == len(log)
        assert {w.log for w in path.windows} == {k}
        assert (path.number[path.middles] == np.arange(len(path.windows))).all()
        spans = [np.ptp(path.walked[path.number == w]) for w in range(len(path.windows))]
        assert max(spans) <= path.walked[-1] / len(path.windows) + 1e-9


def test_a_correction_of_nothing_is_the_log_itself():
    (path,) = cut([LOG], 0.8, CONFIG)
    graph = odometry_graph([path], CONFIG)
    solve(graph)
    after = corrected(path, graph)
    np.testing.assert_allclose(after.positions, LOG.positions, atol=1e-9)
    np.testing.assert_allclose(after.field, LOG.field, atol=1e-15)
    assert (after.orientations * LOG.orientations.inv()).magnitude().max() < 1e-7


def test_a_log_that_moves_as_a_whole_moves_so_in_every_sample():
    (path,) = cut([LOG], 0.8, CONFIG)
    graph = odometry_graph([path], CONFIG)
    T = RigidTransform.from_components([3.0, 1.0, 0.0], Rotation.from_rotvec([0.0, 0.0, 2.0]))
    graph.p, graph.R = T.apply(graph.p), T.rotation.as_matrix() @ graph.R
    after, moved = corrected(path, graph), LOG.transformed(T)
    np.testing.assert_allclose(after.positions, moved.positions, atol=1e-9)
    np.testing.assert_allclose(after.field, moved.field, atol=1e-15)


def test_the_drift_stated_for_one_log_is_its_own():
    config = CONFIG.model_copy(update={"sd_of_logs": {"walk.csv": (1.0, 10.0)}})
    wide, usual = (odometry_graph(cut([LOG], 0.8, c), c).edges.covariance for c in (config, CONFIG))
    assert (np.trace(wide, axis1=1, axis2=2) > 3 * np.trace(usual, axis1=1, axis2=2)).all()


@pytest.mark.parametrize(
    ("turn", "rise", "level"),
    [([0, 0, 1.0], 0.0, True), ([0, 0, 1.0], 1.0, False), ([1.0, 0, 0], 0.0, False), (None, 0.0, True)],
)
def test_logs_are_level_where_height_and_tilt_stay(turn, rise, level):
    rng = np.random.default_rng(0)
    n = 50
    p = np.column_stack([rng.normal(size=(n, 2)), np.linspace(0, rise, n)])
    mounted = Rotation.from_rotvec([0.5, 1.0, 0.0])
    R = None if turn is None else Rotation.from_rotvec(np.linspace(0, 3, n)[:, None] * turn) * mounted
    log = Survey(p, np.full((n, 3), 3e-5), orientations=R)
    assert lie_level([log]) == level
