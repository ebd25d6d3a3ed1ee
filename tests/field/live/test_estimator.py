# SPDX-License-Identifier: BSD-3-Clause
"""The live estimate: the same field as in batch, over any distance, through checkpoints, in spite of bad samples."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magmatch.errors import DataFormatError, SurveyError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.live.estimator import SCHEMA, FieldEstimator
from magmatch.field.live.live_cells import COUNT, KEPT_PER_CELL, N_SUMS, MeasuredCells
from magmatch.field.map import FieldMap
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.spline.spline_prior import CONSTANT_SD
from magmatch.store import load, save

laws = settings(deadline=None, max_examples=6)
H = Hyperparameters(0.5, 1e-5, 5e-7, 0.25, 1.0)
EARTH = np.array([18e-6, 3e-6, -45e-6])


def field_at(x):
    return EARTH + 1e-5 * np.c_[np.sin(2 * x[:, 0]), np.cos(3 * x[:, 1]), x[:, 2]]


def walk(n=900, seed=0, length=2.5):
    """A walk that stands still for a third of the time, so that some cells overflow."""
    rng = np.random.default_rng(seed)
    s = np.maximum(np.linspace(-0.5, 1, n), 0) * length
    x = np.c_[s, 0.6 * np.sin(2 * s), 0.3 + 0.01 * rng.normal(size=n)]
    return x, field_at(x) + 5e-7 * rng.normal(size=x.shape)


def queries(n=12, seed=1, length=2.5):
    s = np.random.default_rng(seed).uniform(0, length, n)
    return np.c_[s, 0.6 * np.sin(2 * s) + 0.1, np.full(n, 0.35)]


def fed(x, b, **kwargs):
    estimator = FieldEstimator(H, **kwargs)
    estimator.update(x, b)
    return estimator


@pytest.fixture(scope="module")
def at_once():
    return fed(*walk())


@laws
@given(seed=st.integers(0, 1000), n_parts=st.integers(1, 40), asked=st.booleans())
def test_order_and_chunks_of_samples_do_not_matter(at_once, seed, n_parts, asked):
    x, b = walk()
    estimator = FieldEstimator(H)
    for rows in np.array_split(np.random.default_rng(seed).permutation(len(x)), n_parts):
        estimator.update(x[rows], b[rows])
        if asked and n_parts < 8:
            estimator.predict(queries(1))
    one, other = estimator.predict(queries(), 1), at_once.predict(queries(), 1)
    np.testing.assert_allclose(one.field, other.field, rtol=0, atol=1e-8 * np.abs(other.field).max())
    gradient = other.values.gradient
    np.testing.assert_allclose(one.values.gradient, gradient, rtol=0, atol=1e-8 * np.abs(gradient).max())
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=0, atol=1e-8 * other.covariance.max())


def test_a_place_smaller_than_a_block_is_one_spline_model(monkeypatch):
    monkeypatch.setattr("magmatch.field.live.estimator.BLOCK", 24)
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 0.5, (400, 3)) * [1, 1, 0.3]
    b = field_at(x) + 5e-7 * rng.normal(size=x.shape)
    model = SplineModel.over(x, H)
    posterior = model.infer(model.observe(x, b))
    live = fed(x, b).predict(x[:20], 2)
    expected = posterior.evaluate(x[:20], 2)
    for name in ("field", "gradient", "second"):
        scale = np.abs(getattr(expected, name)).max()
        np.testing.assert_allclose(getattr(live.values, name), getattr(expected, name), rtol=0, atol=1e-8 * scale)
    exact = posterior.covariance(x[:20])
    np.testing.assert_allclose(live.covariance, exact, rtol=0, atol=1e-8 * exact.max())


def test_a_walk_is_recovered_and_its_spread_is_honest(at_once):
    q = queries(100)
    found = at_once.predict(q, 1)
    error = found.field - field_at(q)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 2e-6
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(found.variance)) > 0.9
    assert found.is_known.all()


def test_the_domain_grows_with_the_walk_and_memory_with_the_cells():
    estimator = FieldEstimator(H)
    sizes = []
    for start in (0.0, 300.0, -5000.0, 20000.0):
        x, b = walk(400)
        there = np.array([start, 0, 0])
        estimator.update(x + there, b)
        near = estimator.predict(queries(4) + there)
        assert near.is_known.all()
        assert np.abs(near.field - field_at(queries(4))).max() < 3e-6
        sizes.append(estimator.n_bytes)
    np.testing.assert_allclose(np.diff(sizes), sizes[0], rtol=0.5)
    standing = np.tile([[20000.0, 0, 0.3]], (5000, 1)), np.tile([EARTH], (5000, 1))
    estimator.update(*standing)
    before = estimator.n_bytes
    estimator.update(*standing)
    estimator.update(*standing)
    assert estimator.n_bytes == before


def test_far_from_all_samples_the_spread_is_the_priors(at_once):
    far = at_once.predict(np.array([[100.0, 0, 0], [-1e6, 1e6, 0]]), 1)
    assert not far.is_known.any()
    assert np.all(far.variance > H.signal_sd**2)
    assert np.all(far.variance < 3 * (H.signal_sd**2 + CONSTANT_SD**2))
    np.testing.assert_allclose(far.field[0], walk()[1].mean(axis=0))
    assert not far.values.gradient.any()


def test_sensor_vectors_are_turned_into_the_map(at_once):
    x, b = walk()
    turns = Rotation.random(len(x), rng=np.random.default_rng(0))
    estimator = FieldEstimator(H)
    estimator.update(x, turns.inv().apply(b), turns.as_quat())
    once = FieldEstimator(H)
    for i in range(len(x)):
        once.update(x[i], turns[i].inv().apply(b[i]), turns[i].as_quat())
    for other in (estimator, once):
        np.testing.assert_allclose(other.predict(queries()).field, at_once.predict(queries()).field, atol=1e-14)


def test_predictions_are_at_most_as_old_as_asked_for():
    now, (x, b) = [0.0], walk()
    estimator = FieldEstimator(H, clock=lambda: now[0])
    estimator.update(x, b)
    q = x[-1:]
    old = estimator.predict(q, max_age=1.0).field
    estimator.update(q, b[-1:] + 5e-6)
    changes = []
    for now[0] in (0.9, 1.0):
        changes.append(np.abs(estimator.predict(q, max_age=1.0).field - old).max())
    estimator.update(q, b[-1:] - 5e-6)
    changes.append(np.abs(estimator.predict(q, max_age=1.0).field - old).max())
    changes.append(np.abs(estimator.predict(q).field - old).max())
    # Rounding where shares do not quite sum to one.
    assert changes[0] < 1e-18
    assert changes[1] > 1e-8
    assert changes[2] == pytest.approx(changes[1])
    assert changes[3] < 0.5 * changes[1]


@pytest.mark.parametrize("n", [300, 900])
def test_a_resumed_estimate_predicts_the_same_bits(tmp_path, n):
    x, b = walk()
    estimator = fed(x[:n], b[:n])
    estimator.save(tmp_path / "a.live")
    again = FieldEstimator.load(tmp_path / "a.live")
    for _ in range(2):
        one, other = estimator.predict(queries(), 2), again.predict(queries(), 2)
        assert np.array_equal(one.values.second, other.values.second)
        assert np.array_equal(one.covariance, other.covariance)
        assert len(again) == len(estimator)
        for e in (estimator, again):
            e.update(x[: n // 2], b[: n // 2])
    again.save(tmp_path / "b.live")
    estimator.save(tmp_path / "c.live")
    assert (tmp_path / "b.live").read_bytes() == (tmp_path / "c.live").read_bytes()


def test_hyperparameters_are_chosen_from_the_first_samples_and_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("magmatch.field.live.estimator.N_FIRST", 300)
    x, b = walk()
    x, b = x[300:], b[300:]
    estimator = FieldEstimator()
    with pytest.raises(SurveyError, match="at least 10 samples"):
        estimator.predict(queries())
    estimator.update(x[:100], b[:100])
    assert estimator.hyperparameters is None
    early = estimator.predict(x[50:51])
    assert np.abs(early.field - field_at(x[50:51])).max() < 3e-6
    for_now = estimator.hyperparameters
    estimator.save(tmp_path / "a.live")
    for e in (estimator, FieldEstimator.load(tmp_path / "a.live")):
        assert e.hyperparameters == for_now
        e.update(x[100:500], b[100:500])
        e.update(x[500:], b[500:])
        assert len(e) == len(x)
        assert e.hyperparameters != for_now
        assert np.abs(e.predict(queries()).field - field_at(queries())).max() < 5e-6
    settled = estimator.hyperparameters
    assert estimator.choose_hyperparameters() == estimator.hyperparameters != settled
    assert len(estimator) == len(x)


def test_numbers_chosen_again_keep_the_cells_that_hold_sums():
    rng = np.random.default_rng(5)
    x = np.r_[walk()[0], 0.02 * rng.normal(size=(300, 3))]
    estimator = fed(x, field_at(x) + 5e-7 * rng.normal(size=x.shape))
    chosen = estimator.choose_hyperparameters()
    assert chosen.spacing == H.spacing
    assert chosen != H
    assert len(estimator) == len(x)
    assert np.abs(estimator.predict(queries()).field - field_at(queries())).max() < 5e-6


def test_a_live_estimate_becomes_a_map(caplog, tmp_path, monkeypatch):
    monkeypatch.setattr("magmatch.field.live.estimator.BLOCK", 40)
    x, b = walk(200, length=1.5)
    x = x + np.array([0.0, 0.0, 1.0])
    field_map = fed(x[66:], b[66:]).to_map()
    assert isinstance(field_map, FieldMap)
    assert field_map.hyperparameters.spacing == H.spacing
    q = x[100:120]
    live = fed(x[66:], b[66:]).predict(q)
    np.testing.assert_allclose(field_map.evaluate(q).field, live.field, atol=1e-8 * np.abs(b).max())
    np.testing.assert_allclose(field_map.covariance(q), live.covariance, atol=1e-8 * live.covariance.max())
    field_map.save(tmp_path / "live.map")
    assert np.array_equal(FieldMap.load(tmp_path / "live.map").evaluate(q).field, field_map.evaluate(q).field)
    with caplog.at_level(logging.WARNING):
        thinned = fed(np.zeros((500, 3)), np.tile(EARTH, (500, 1))).to_map()
    assert len(thinned.survey) == KEPT_PER_CELL
    assert "64 of 500" in caplog.text


BAD = {
    "NaN": (np.array([0, 0, np.nan]), EARTH, None, SurveyError, "finite"),
    "microtesla": (np.zeros(3), 1e6 * EARTH, None, SurveyError, "is it in tesla"),
    "millimetres": (np.array([2e8, 0, 0]), EARTH, None, SurveyError, "is it in metres"),
    "different counts": (np.zeros((4, 3)), np.zeros((3, 3)), None, ValueError, r"\(4, 3\) and \(3, 3\)"),
    "no quaternion": (np.zeros(3), EARTH, np.zeros(3), ValueError, "quaternions"),
    "quaternion NaN": (np.zeros(3), EARTH, np.full(4, np.nan), SurveyError, "unit"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_samples_are_refused_and_change_nothing(name):
    position, field, orientation, error, words = BAD[name]
    x, b = walk(300)
    estimator, clean = fed(x[:150], b[:150]), fed(x, b)
    with pytest.raises(error, match=words) as caught:
        estimator.update(position, field, orientation)
    assert "\n" not in str(caught.value)
    estimator.update(x[150:], b[150:])
    assert len(estimator) == 300
    assert np.array_equal(estimator.predict(queries()).field, clean.predict(queries()).field)


def test_variance_is_left_out_where_it_is_not_wanted(at_once):
    without = at_once.predict(queries(), 1, with_variance=False)
    assert np.isnan(without.covariance).all()
    assert np.array_equal(without.values.gradient, at_once.predict(queries(), 1).values.gradient)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "a.live"
    fed(*walk()).save(path)
    return path


def replaced(measured, **changes):
    """What was read, and is not checked any more, with other arrays."""
    for name, value in changes.items():
        object.__setattr__(measured, name, value)
    return {"measured": measured}


CRAFTED = {
    "no spacing": lambda c, m: {"hyperparameters": replace(c["hyperparameters"], spacing=0.0)},
    "another start": lambda c, m: {"start": c["start"] + 1e9},
    "no samples": lambda c, m: replaced(m, kept=np.zeros((0, 6))),
    "too many of a cell": lambda c, m: replaced(m, kept=np.repeat(m.kept, 3, axis=0)),
    "sums elsewhere": lambda c, m: replaced(m, cells=m.cells + 1000),
    "other columns": lambda c, m: replaced(m, sums=np.zeros((len(m.sums), N_SUMS - 1))),
    "NaN": lambda c, m: replaced(m, squares=np.full((3, 3), np.nan)),
    "half a sample": lambda c, m: replaced(m, sums=m.sums + 0.5 * (np.arange(N_SUMS) == COUNT)),
    "an unknown class": lambda c, m: {"measured": H},
}


@pytest.mark.parametrize("name", CRAFTED)
def test_crafted_checkpoints_are_one_clear_error(checkpoint, tmp_path, name):
    content = load(checkpoint, SCHEMA, (Hyperparameters, MeasuredCells))
    save(tmp_path / "bad.live", SCHEMA, content | CRAFTED[name](content, content["measured"]))
    with pytest.raises(DataFormatError) as caught:
        FieldEstimator.load(tmp_path / "bad.live")
    assert "\n" not in str(caught.value)
    with pytest.raises(DataFormatError):
        FieldMap.load(checkpoint)
