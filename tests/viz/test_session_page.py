# SPDX-License-Identifier: BSD-3-Clause
"""The report of a session: the verdict first, every frame drawn, rejected closures said to be so."""

from dataclasses import replace

import numpy as np
import pytest

from drifting import Place, drifting_walk
from magmatch.slam.run import slam

pytest.importorskip("plotly", reason="pictures are drawn with the extra 'viz'")

from magmatch.viz.pages.session_page import session_figures, weakness_figure, write_session_report


@pytest.fixture(scope="module")
def session():
    """A walk twice round whose last closure the graph is made to reject."""
    session = slam(drifting_walk(Place(1), 1, name="<walk>.csv")[0])
    *others, last = session.graph.closures
    session.graph.closures = [*others, replace(last, weight=0.01)]
    return session


def test_before_and_after_show_the_path_and_every_closure(session):
    before, after = session_figures(session, 0)
    assert len(before.data) == 1
    closures = {trace.name: trace for trace in after.data if "closure" in str(trace.name)}
    assert set(closures) == {"closure", "rejected closure"}
    drawn = {name: int(np.isnan(trace.x).sum()) for name, trace in closures.items()}  # a gap after each
    assert drawn == {"closure": len(session.graph.closures) - 1, "rejected closure": 1}
    ends = np.column_stack([closures["rejected closure"].x, closures["rejected closure"].y])[:2]
    last = session.graph.closures[-1]
    np.testing.assert_allclose(ends, session.graph.p[[last.first, last.second], :2], rtol=1e-5)


def test_the_first_node_is_sure_and_others_are_as_the_graph_says(session):
    (trace,) = weakness_figure(session).data
    assert trace.y[0] < 1e-3
    (end,) = session.standard_deviations(session.paths[0].nodes[-1:])
    assert trace.y[-1] == pytest.approx(end[0], rel=1e-5)


def test_the_page_says_the_verdict_first_and_escapes_names(session, tmp_path):
    write_session_report(tmp_path / "r.html", session, session.result(), "magmatch slam ...")
    page = (tmp_path / "r.html").read_text()
    body = page[page.index("<main") :]
    assert body.index("Connected") < body.index("What to do next") < body.index("Before")
    assert "rejected" in body
    assert "<walk>" not in body


def test_ellipses_hold_ninety_five_percent_of_where_a_node_may_be(session):
    _, after = session_figures(session, 0)
    (trace,) = [t for t in after.data if "95 %" in str(t.name)]
    x, y = (np.array(v).reshape(-1, 34)[:, :33] for v in (trace.x, trace.y))  # a gap after each
    assert len(x) == len(session.graph.p)
    node = len(x) - 1
    C = session.covariances_of_place(np.array([node]))[0][:2, :2]
    d = np.stack([x[node], y[node]], axis=1) - session.graph.p[node, :2]
    np.testing.assert_allclose(np.einsum("ni,ni->n", d, np.linalg.solve(C, d.T).T), 5.991, rtol=1e-3)


def test_a_recording_holds_logs_on_their_way_and_closures(session, tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    from magmatch.viz.rerun_recording import N_STEPS, write_session_rerun

    write_session_rerun(tmp_path / "s.rrd", session)
    chunks = list(RrdReader(tmp_path / "s.rrd").stream())
    rows = {}
    for chunk in chunks:
        rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + chunk.num_rows
    assert rows["/closures"] == rows["/rejected"] == 1
    (log,) = [n for path, n in rows.items() if path.startswith("/logs/")]
    assert log == N_STEPS + 1
