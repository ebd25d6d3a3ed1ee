# SPDX-License-Identifier: BSD-3-Clause
"""One more log for a finished session: what was found before stays, and a session that cannot be is refused."""

from dataclasses import replace

import numpy as np
import pytest

from drifting import Place, drifting_walk
from magmatch.errors import DataFormatError
from magmatch.slam.loop_search import LoopSearch
from magmatch.slam.output.folder import require_folder, write_folder
from magmatch.slam.output.kept_session import KINDS, SCHEMA, SESSION, read_session
from magmatch.store import load, save

OTHER, _ = drifting_walk(Place(1), 2, laps=1.2, start=2.0, name="b.csv")


@pytest.fixture(scope="module")
def folder(lone, tmp_path_factory):
    place = tmp_path_factory.mktemp("kept") / "out"
    write_folder(lone.session, place)
    return place


def test_a_session_read_again_is_what_it_was(lone, folder):
    session, new = read_session(folder, [OTHER, lone.log])
    assert new == [OTHER]
    assert session.given == [lone.log]
    ours, theirs = session.graph, lone.session.graph
    np.testing.assert_array_equal(ours.p, theirs.p)
    assert [(c.first, c.second, c.log_odds) for c in ours.closures] == [
        (c.first, c.second, c.log_odds) for c in theirs.closures
    ]
    assert [f.node for f in ours.submap_factors] == [f.node for f in theirs.submap_factors] != []
    assert session.places.maker.noise == lone.session.places.maker.noise
    assert session.config == lone.session.config
    session.add_logs([])  # as a finished command that is run again does
    np.testing.assert_allclose(session.graph.p, theirs.p, atol=1e-5)
    assert len(session.graph.submap_factors) == len(theirs.submap_factors)


def test_one_more_log_is_tied_and_nothing_is_looked_for_again(lone, folder, monkeypatch):
    looked, at = [], LoopSearch.at

    def noted(self, windows, *about):
        looked.extend(window.log for window in windows)
        return at(self, windows, *about)

    monkeypatch.setattr(LoopSearch, "at", noted)
    session, new = read_session(folder, [lone.log, OTHER])
    session.add_logs(new)
    assert session.components == [[0, 1]]
    assert set(looked) == {1}
    n = len(lone.session.graph.closures)
    assert [c.log_odds for c in session.graph.closures[:n]] == [c.log_odds for c in lone.session.graph.closures]


def test_folders_that_hold_no_such_session_are_refused(lone, folder, tmp_path):
    with pytest.raises(DataFormatError, match="not given or were changed"):
        read_session(folder, [OTHER])
    with pytest.raises(DataFormatError, match="no session to continue"):
        read_session(tmp_path, [lone.log])
    with pytest.raises(DataFormatError, match="fewer inputs; add the others with --continue, name a new folder"):
        require_folder(folder, [lone.log, OTHER], to_add="add the others with --continue, ")
    require_folder(folder, [lone.log, OTHER], may_be_more=True)
    content = load(folder / SESSION, SCHEMA, KINDS)
    for key, value in [("closures", [{"first": 1}]), ("noise", {"size": 3}), ("anchors", [[1]]), ("length", "far")]:
        save(tmp_path / SESSION, SCHEMA, content | {key: value})
        with pytest.raises(DataFormatError, match=r"session\.state: "):
            read_session(tmp_path, [lone.log])


def test_what_cannot_be_gone_on_from_leaves_no_session(lone, tmp_path):
    constant = replace(lone.session, places=replace(lone.session.places, maker=None))
    write_folder(constant, tmp_path / "out")
    assert not (tmp_path / "out" / SESSION).exists()
