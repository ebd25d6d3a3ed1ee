# SPDX-License-Identifier: BSD-3-Clause
"""Viewers: what is in space, served live by viser, and recorded for Rerun."""

import sys
from dataclasses import replace
from urllib.request import urlopen

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.errors import MissingExtraError
from magmatch.viz.figures.slices import cut_normal_to, cut_through
from magmatch.viz.viewers.exhibit import box_of, cut_colors, exhibit, shaded
from magmatch.viz.viewers.live_viewer import BY_FIELD, BY_SURVEY, address_of, require_viser, serve
from magmatch.viz.viewers.rerun_recording import N_STEPS, require_rerun, write_rerun


@pytest.fixture
def shown(pair):
    return exhibit([pair.base_map, pair.target_map], pair.accepted)


# What is in space


def test_the_target_goes_from_where_it_was_recorded_to_where_it_belongs(shown, pair):
    start, end = shown.pose_of_target(0.0), shown.pose_of_target(1.0)
    np.testing.assert_allclose(start.as_matrix(), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(end.as_matrix(), pair.accepted.T_base_target.as_matrix(), atol=1e-12)
    half = shown.pose_of_target(0.5).rotation.magnitude()
    assert half == pytest.approx(pair.accepted.T_base_target.rotation.magnitude() / 2)


def test_without_a_pose_the_target_stays(pair):
    none = exhibit([pair.base, pair.target], replace(pair.refused, alternatives=()))
    assert none.T_base_target is None
    np.testing.assert_array_equal(none.pose_of_target(1.0).as_matrix(), np.eye(4))


def test_shades_rise_in_lightness():
    grey = shaded(np.linspace(0, 1, 50), (0.0, 1.0)) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(grey) > 0).all()


def test_shades_stay_within_their_range():
    colors = shaded(np.array([-1e9, 0.0, 1.0, 1e9]), (0.0, 1.0))
    np.testing.assert_array_equal(colors[[0, 3]], colors[[1, 2]])


def test_a_cut_is_known_where_the_map_is(pair):
    cut = cut_through(pair.base.positions)
    for quantity in ("field magnitude", "standard deviation"):
        colors, is_known = cut_colors(pair.base_map, cut, quantity, (0.0, 100.0))
        assert colors.shape == (len(cut.points), 3)
        assert np.array_equal(is_known, pair.base_map.knows(cut.points))


def test_a_cut_can_be_laid_at_any_height(pair):
    cut = cut_normal_to(pair.base.positions, 1, 0.75)
    assert (cut.points[:, 1] == 0.75).all()


def test_the_box_holds_both_surveys_where_they_belong(shown, pair):
    low, high = box_of(shown)
    T = pair.accepted.T_base_target
    for p in (pair.base.positions, T.apply(pair.target.positions)):
        assert (p >= low).all()
        assert (p <= high).all()


def test_names_of_parts_cannot_nest_or_repeat(pair):
    survey = replace(pair.base, name="a/b.csv")
    assert [part.name for part in exhibit([survey, survey, pair.target]).parts] == [
        "a_b.csv 1", "a_b.csv 2", "target.csv",
    ]  # fmt: skip


def test_thinning_is_said(pair):
    p = np.random.default_rng(0).uniform(0, 1, (100_500, 3))
    large = replace(pair.base, positions=p, field=np.full(p.shape, 3e-5), times=None)
    assert any("100000 drawn" in words for words in exhibit([large]).words)


# viser


@pytest.fixture
def server(shown):
    pytest.importorskip("viser")
    with serve(shown, port=18_650) as started:
        yield started


def control(server, label):
    """A control of the panel by its label."""
    return next(h for h in server.gui._gui_input_handle_from_uuid.values() if getattr(h, "label", None) == label)


def test_the_viewer_answers_and_holds_everything(server):
    with urlopen(address_of(server), timeout=20) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()
    for name in ("/base", "/base/samples", "/base/cut", "/target", "/target/samples", "/target/cut", "/links"):
        assert server.scene.get_handle_by_name(name) is not None, name


def test_the_viewer_listens_to_this_machine_only(server):
    assert server.get_host() == "127.0.0.1"


def test_the_target_follows_the_slider(server, shown):
    target = server.scene.get_handle_by_name("/target")
    lines = server.scene.get_handle_by_name("/links")
    assert np.ptp(lines.points, axis=1).max() < 1e-5
    control(server, "Registered").value = 0.0
    np.testing.assert_allclose(target.position, 0, atol=1e-12)
    assert np.ptp(lines.points, axis=1).max() > 0.1
    control(server, "Registered").value = 1.0
    np.testing.assert_allclose(target.position, shown.T_base_target.translation)
    np.testing.assert_allclose(target.wxyz, shown.T_base_target.rotation.as_quat(scalar_first=True))


def test_the_colour_of_samples_can_be_chosen(server):
    cloud = server.scene.get_handle_by_name("/base/samples")
    assert len(np.unique(cloud.colors, axis=0)) == 1
    control(server, "Colour of samples").value = BY_FIELD
    assert len(np.unique(cloud.colors, axis=0)) > 50
    control(server, "Colour of samples").value = BY_SURVEY
    assert len(np.unique(cloud.colors, axis=0)) == 1


def test_a_cut_follows_its_slider(server, pair):
    control(server, "Place along it").value = 1.0
    height = server.scene.get_handle_by_name("/base/cut").position[2]
    assert height == pytest.approx(pair.base.positions[:, 2].max(), abs=1e-6)


def test_surveys_alone_are_shown_without_a_registration(pair):
    pytest.importorskip("viser")
    with serve(exhibit([pair.base]), port=18_651) as server:
        assert server.scene.get_handle_by_name("/base.csv/samples") is not None
        assert server.scene.get_handle_by_name("/links") is None


def test_a_taken_port_is_stepped_over(pair):
    pytest.importorskip("viser")
    with serve(exhibit([pair.base]), port=18_652) as one, serve(exhibit([pair.base]), port=18_652) as two:
        assert one.get_port() != two.get_port()


# Rerun


@pytest.fixture
def chunks(shown, tmp_path):
    """What Rerun's own reader finds, by path of the entity."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    write_rerun(tmp_path / "o.rrd", shown)
    found = {}
    for chunk in RrdReader(tmp_path / "o.rrd").stream():
        found.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return found


def column(batches, component):
    """Values of a component, over all batches."""
    return [
        value
        for batch in batches
        for name in batch.schema.names
        if name.endswith(component)
        for value in batch.column(name).to_pylist()
        if value is not None
    ]


def test_a_recording_holds_everything(chunks, pair):
    assert {"/base/samples", "/base/cut", "/target/samples", "/target/cut", "/target", "/links", "/words"} <= set(
        chunks
    )
    (points,) = column(chunks["/base/samples"], "positions")
    np.testing.assert_allclose(points, pair.base.positions, atol=1e-6)
    (bx,) = column(chunks["/base/samples"], "bx_ut")
    np.testing.assert_allclose(bx, 1e6 * pair.base.field[:, 0], rtol=1e-6)


def test_a_recording_ends_where_the_target_is_registered(chunks, pair):
    translations = column(chunks["/target"], "translation")
    quaternions = column(chunks["/target"], "quaternion")
    assert len(translations) == N_STEPS + 1
    T = pair.accepted.T_base_target
    np.testing.assert_allclose(translations[-1][0], T.translation, atol=1e-6)
    np.testing.assert_allclose(quaternions[-1][0], T.rotation.as_quat(), atol=1e-6)
    np.testing.assert_allclose(translations[0][0], 0, atol=1e-6)


def test_a_recording_of_surveys_needs_no_registration(pair, tmp_path):
    pytest.importorskip("rerun")
    write_rerun(tmp_path / "o.rrd", exhibit([pair.base, replace(pair.base, name="a b/c.csv")]))
    assert (tmp_path / "o.rrd").stat().st_size > 1000


def test_a_failed_recording_leaves_the_old_one(pair, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    path = tmp_path / "o.rrd"
    path.write_bytes(b"old")
    broken = replace(exhibit([pair.base]), T_base_target=RigidTransform.identity())
    monkeypatch.setattr("magmatch.viz.viewers.rerun_recording._log_registration", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_rerun(path, broken)
    assert path.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("module", "require", "extra"), [("viser", require_viser, "view"), ("rerun", require_rerun, "rerun")]
)
def test_a_missing_viewer_is_named(monkeypatch, module, require, extra):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"pip install '\.\[{extra}\]'"):
        require()
