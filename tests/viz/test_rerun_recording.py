# SPDX-License-Identifier: BSD-3-Clause
"""Recordings for Rerun: what is in space, and what Rerun's own reader finds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.registration.result import Links
from magmatch.viz.rerun_recording import N_STEPS, scene_of, shaded, write_rerun


@pytest.fixture
def shown(pair):
    return scene_of([pair.base_map, pair.target_map], pair.accepted)


# What is in space


def test_the_target_goes_from_where_it_was_recorded_to_where_it_belongs(shown, pair):
    start, end = shown.pose_of_target(0.0), shown.pose_of_target(1.0)
    np.testing.assert_allclose(start.as_matrix(), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(end.as_matrix(), pair.accepted.T_base_target.as_matrix(), atol=1e-12)
    half = shown.pose_of_target(0.5).rotation.magnitude()
    assert half == pytest.approx(pair.accepted.T_base_target.rotation.magnitude() / 2)


def test_without_a_pose_the_target_stays(pair):
    none = scene_of([pair.base, pair.target], replace(pair.refused, alternatives=()))
    assert none.T_base_target is None
    np.testing.assert_array_equal(none.pose_of_target(1.0).as_matrix(), np.eye(4))


def test_shades_rise_in_lightness_and_stay_within_their_range():
    grey = shaded(np.linspace(0, 1, 50), (0.0, 1.0)) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(grey) > 0).all()
    colors = shaded(np.array([-1e9, 0.0, 1.0, 1e9]), (0.0, 1.0))
    np.testing.assert_array_equal(colors[[0, 3]], colors[[1, 2]])


def test_names_of_parts_cannot_nest_or_repeat(pair):
    survey = replace(pair.base, name="a/b.csv")
    assert [part.name for part in scene_of([survey, survey, pair.target]).parts] == [
        "a_b.csv 1", "a_b.csv 2", "target.csv",
    ]  # fmt: skip


def test_thinning_is_said(pair):
    p = np.random.default_rng(0).uniform(0, 1, (100_500, 3))
    large = replace(pair.base, positions=p, field=np.full(p.shape, 3e-5), times=None)
    assert any("100000 drawn" in words for words in scene_of([large]).words)


# Rerun


@pytest.fixture
def chunks(shown, tmp_path):
    pytest.importorskip("rerun")
    write_rerun(tmp_path / "o.rrd", shown)
    return chunks_of(tmp_path / "o.rrd")


def chunks_of(path):
    """What Rerun's own reader finds, by path of the entity."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream():
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


UTM = np.array([691234.5, 5334567.25, 512.0])


def far(pair, base, target):
    """The pair in frames with other origins."""
    T_base, T_target = RigidTransform.from_translation(base), RigidTransform.from_translation(target)
    T = T_base * pair.accepted.T_base_target * T_target.inv()
    links = Links(pair.accepted.links.base + base, pair.accepted.links.target + target)
    result = replace(pair.accepted, T_base_target=T, links=links)
    return scene_of([pair.base.transformed(T_base), pair.target.transformed(T_target)], result)


@pytest.mark.parametrize(("base", "target"), [(UTM, UTM), (UTM, 0 * UTM), (0 * UTM, UTM[[1, 0, 2]])])
def test_a_recording_of_far_frames_shows_samples_where_they_are(pair, base, target, tmp_path):
    pytest.importorskip("rerun")
    shown = far(pair, base, target)
    write_rerun(tmp_path / "o.rrd", shown)
    chunks = chunks_of(tmp_path / "o.rrd")
    near = pair.accepted.T_base_target.apply(pair.target.positions) + base - shown.parts[0].origin
    (p,) = column(chunks["/target/samples"], "positions")
    T = RigidTransform.from_components(
        column(chunks["/target"], "translation")[-1][0],
        Rotation.from_quat(column(chunks["/target"], "quaternion")[-1][0]),
    )
    # Single precision of positions within a kilometre and of a quaternion.
    np.testing.assert_allclose(T.apply(np.array(p)), near, atol=3e-4)
    (q,) = column(chunks["/base/samples"], "positions")
    np.testing.assert_allclose(q, pair.base.positions + base - shown.parts[0].origin, atol=1e-4)
    links = np.array(column(chunks["/links"], "strips")[-1])
    assert np.ptp(links, axis=1).max() < 1e-3
    # Where the origin is, is said in numbers and in words.
    for part, place in zip(shown.parts, (base, target), strict=True):
        assert np.abs(part.origin - place).max() < 1000
        found = column(chunks.get(f"/{part.name}", []), "origin_m")
        assert np.array_equal(np.ravel(found), part.origin) if place.any() else not found
    assert any("691000, 5334000" in words or "5334000, 691000" in words for words in shown.words)


def test_a_failed_recording_leaves_the_old_one(pair, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    path = tmp_path / "o.rrd"
    path.write_bytes(b"old")
    broken = replace(scene_of([pair.base]), T_base_target=RigidTransform.identity())
    monkeypatch.setattr("magmatch.viz.rerun_recording._log_registration", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_rerun(path, broken)
    assert path.read_bytes() == b"old"
